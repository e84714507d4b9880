"""The client of running faces' control sockets: find faces, send commands, stop them and wait."""

import contextlib
import errno
import json
import os
import socket
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from firmware_bridge.process import commands
from firmware_bridge.process.control_socket import LONGEST_WORD, WATCH_WORD, peer
from firmware_bridge.process.runtime_folder import (
    SOCKET_SUFFIX,
    ControlError,
    held_folder,
    is_dead_socket,
    knock,
    read_socket_name,
    searched_folders,
)
from firmware_bridge.stopping import START_WHILE_STOPPING, ServoSwitch, StopLevel

#: Longer than the status of 252 servos.
_LONGEST_ANSWER: Final = 1 << 18
#: A supervisor notices a hung bridge within a second and answers in its place.
PATIENCE_S: Final = 2.0
#: A request is repeated after this, if the face's process was replaced before it answered.
_RETRY_S: Final = 0.05
#: No setting and no servo is called by a longer one, in characters.
_LONGEST_NAME: Final = 40

Answer = dict[str, Any]


@dataclass(frozen=True, slots=True)
class RunningFace:
    """A robot face whose process runs and listens at its control socket, `path`.

    pid: the process that made the socket; of a daemon, the supervisor.
    """

    name: str
    pid: int
    path: Path


def running_faces() -> list[RunningFace]:
    """Return all faces that listen in `searched_folders`, sorted by name.

    Sockets of this user on which no process listens are removed.
    """
    found = []
    # As the kernel lists the sockets: without links.
    for folder in dict.fromkeys(each.resolve() for each in searched_folders()):
        for path in sorted(folder.glob(f"*{SOCKET_SUFFIX}")):
            named = read_socket_name(path)
            if named is not None and _listens(path):
                found.append(RunningFace(*named, path))
    return sorted(found, key=lambda face: (face.name, face.pid))


def face_at(path: Path) -> RunningFace:
    """Return the face that listens at the socket `path`.

    Raises ControlError if none listens or access is denied.
    """
    path = path.parent.resolve() / path.name
    try:
        with _connected(path, time.monotonic() + PATIENCE_S) as client:
            pid, _ = peer(client)
    except OSError as error:
        why = error.strerror or str(error)
        why = f"{printable(str(path))}: no face answers there: {why}; is a face running?"
        raise ControlError(why) from error
    named = read_socket_name(path)
    return RunningFace(printable(path.stem) if named is None else named[0], pid, path)


def ask(path: Path, word: str, patience_s: float = PATIENCE_S) -> Answer:
    """Send the command `word` to the face at `path`; return its answer, a JSON object.

    The command is sent again while a process of the face closes the connection without an answer.
    Raises OSError when no answer comes within `patience_s`.
    """
    give_up_s = time.monotonic() + patience_s
    while True:
        with _connected(path, give_up_s) as client:
            with contextlib.suppress(ConnectionError):  # `_receive` finds it closed
                client.send(word.encode())
            answer = _receive(client, give_up_s)
        if answer is not None:
            return answer
        _wait_to_retry(give_up_s)


def send_stop(path: Path, level: StopLevel, *, end: bool = False) -> socket.socket:
    """Send a stop of `level` to the face at `path`, without waiting: for event loops, many faces.

    Parameters
    ----------
    end : whether a daemon's process ends after the stop; otherwise it waits, limp, for a start.

    Returns
    -------
    The non-blocking connection on which the answer and, unless FREEZE, the report of the end come.
    If the face closes it without an answer, the face's process was replaced: send the stop again.

    Raises
    ------
    OSError
        Where no face listens; BlockingIOError where too many clients wait there already.

    """
    client = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    try:
        client.setblocking(False)
        client.connect(str(path))
        with contextlib.suppress(ConnectionError):  # then the answer is the end of the connection
            words = (level.value, commands.END_WORD) if end else (level.value,)
            client.send(" ".join(words).encode())
    except OSError:
        client.close()
        raise
    return client


def start_face(path: Path, patience_s: float = PATIENCE_S) -> Answer:
    """Start the stopped face at `path`; return {"accepted": "start"}, or {"error": one line}.

    While the face is still stopping the order is sent again, up to `patience_s`. Raises OSError
    when no face answers. Whether the face is then driven is in its answer to `status`, under
    `state` and `troubles`.
    """
    give_up_s = time.monotonic() + patience_s
    while True:
        answer = ask(path, commands.START_WORD, patience_s)
        is_stopping = answer.get("error") == START_WHILE_STOPPING
        if not is_stopping or time.monotonic() + _RETRY_S > give_up_s:
            return answer
        time.sleep(_RETRY_S)


def change_setting(path: Path, name: str, value: float) -> Answer:
    """Change a setting of the face at `path`; return {"set", "value"}, or {"error": one line}.

    Raises OSError when no face answers.
    """
    answer = change_settings(path, {name: value})
    return answer if "error" in answer else {**answer, "set": name, "value": value}


def change_settings(path: Path, values: Mapping[str, float]) -> Answer:
    """Change settings of the face at `path`, all or none.

    Return {"set": {name: value}}, or {"error": one line}. Raises OSError when no face answers.
    """
    pairs = [f"{name} {float(value)!r}" for name, value in values.items()]
    word = " ".join((commands.SET_WORD, *pairs))
    for name in values:
        if not _is_name(name):
            return {"error": f"{name[:_LONGEST_NAME]!r}: no such setting"}
    if len(word.encode()) > LONGEST_WORD:
        return {"error": "too many settings at once"}
    answer = ask(path, word)
    if "error" in answer:
        return answer
    answer.pop("value", None)
    return {**answer, "set": dict(values)}


def switch_servo(path: Path, name: str, switch: ServoSwitch) -> Answer:
    """Send the order to switch one servo off or on, or reboot it; return {"servo"} or {"error"}.

    The effect is in the face's answer to `status`, under `servos` and `troubles`. Raises OSError
    when no face answers.
    """
    return _ask_of(path, commands.SERVO_WORD, name, switch.value)


def arm_jog(path: Path) -> Answer:
    """Start or prolong jogging, which moves single joints by command.

    Return {"jog": "arm"} or {"error"}. Raises OSError when no face answers.
    """
    return ask(path, f"{commands.JOG_WORD} {commands.ARM_WORD}")


def jog_servo(path: Path, name: str, position_deg: float) -> Answer:
    """Move the joint `name` to an angle in degrees; return {"jog", "position_deg"} or {"error"}.

    Jogging ends 3 s after the last jog command of any kind. Raises OSError when no face answers.
    """
    return _ask_of(path, commands.JOG_WORD, name, repr(float(position_deg)))


def jog_pulse(path: Path, name: str, pulse_us: float) -> Answer:
    """Send the hobby servo `name` to a pulse in us; return {"jog", "pulse_us"} or {"error"}.

    Beyond the servo's limits the pulse changes in small steps, so that a person can find the
    limits. Raises OSError when no face answers.
    """
    return _ask_of(path, commands.JOG_WORD, name, f"{float(pulse_us)!r} {commands.PULSE_UNIT}")


def end_jog(path: Path) -> Answer:
    """End jogging, so that all joints return to their ordinary goals.

    Return {"jog": "end"} or {"error"}. Raises OSError when no face answers.
    """
    return ask(path, f"{commands.JOG_WORD} {commands.END_WORD}")


def _ask_of(path: Path, word: str, name: str, what: str) -> Answer:
    if not _is_name(name):
        return {"error": f"{name[:_LONGEST_NAME]!r}: no such servo"}
    return ask(path, f"{word} {name} {what}")


def _is_name(text: str) -> bool:
    """Return whether a text is one printable word of at most 40 characters."""
    return text.split() == [text] and text.isprintable() and len(text) <= _LONGEST_NAME


def watch(path: Path, patience_s: float = PATIENCE_S) -> int:
    """Return a read-only descriptor of the shared memory with the state of the face at `path`.

    `lipservo.runtime.status.live_board` reads that memory. Raises OSError when no face answers
    within `patience_s`, ControlError when the face cannot be watched.
    """
    give_up_s = time.monotonic() + patience_s
    raw = b""
    handed: list[int] = []
    while not raw:  # a face whose process is being replaced closes the connection
        with _connected(path, give_up_s) as client, contextlib.suppress(ConnectionError):
            client.send(WATCH_WORD.encode())
            raw, handed, _, _ = socket.recv_fds(client, _LONGEST_ANSWER, 1)
        if not raw:
            _wait_to_retry(give_up_s)
    if not handed:
        why = _answer_in(raw).get("error", "no memory was handed out")
        raise ControlError(f"{printable(str(path))}: {why}")
    os.set_inheritable(handed[0], False)
    return handed[0]


def stop_and_wait(
    path: Path,
    level: StopLevel,
    patience_s: float,
    answer_s: float = PATIENCE_S,
    *,
    end: bool = False,
    sent: socket.socket | None = None,
) -> tuple[Answer, Answer | None]:
    """Stop a face by `level`, and wait for the end; return its answer and its report of the end.

    end: whether a daemon's process ends with it. sent: the connection from `send_stop`, if the stop
    was sent already.

    The report is None for FREEZE, and for a face that has ended without one or did not end within
    `patience_s`. When the bridge dies in between, the stop is sent again. Raises TimeoutError when
    no answer comes within `answer_s`, OSError when no process listens.
    """
    began_s = time.monotonic()
    give_up_s = began_s + patience_s
    first: Answer | None = None
    while True:
        answer_by_s = min(give_up_s, (time.monotonic() if first else began_s) + answer_s)
        try:
            client, sent = sent or send_stop(path, level, end=end), None
            with client:
                answer = _receive(client, answer_by_s)
                first = first or answer
                if answer is not None and level is StopLevel.FREEZE:
                    return answer, None
                report = _receive(client, give_up_s) if answer is not None else None
            if first is not None and report is not None:
                return first, report
            _wait_to_retry(give_up_s)
        except BlockingIOError:  # too many clients wait there, as when the process hangs
            _wait_to_retry(answer_by_s)
        except OSError:
            if first is None:
                raise
            return first, None


def _receive(client: socket.socket, give_up_s: float) -> Answer | None:
    """Return the face's next message; None: the face closed the connection.

    Raises TimeoutError when neither happens until monotonic `give_up_s`, and OSError for a message
    that is no JSON object.
    """
    client.settimeout(max(0.001, give_up_s - time.monotonic()))
    try:
        raw = client.recv(_LONGEST_ANSWER)
    except ConnectionError:
        raw = b""
    return _answer_in(raw) if raw else None


def _answer_in(raw: bytes) -> Answer:
    """Return the JSON object in `raw`, with all text made printable: any program may send it.

    Raises OSError if `raw` is no JSON object.
    """
    try:
        return dict(printable(json.loads(raw)))
    except (ValueError, TypeError, RecursionError):
        raise OSError(errno.EPROTO, "the program that answers there is not a face") from None


def printable(value: Any) -> Any:
    """Return a value of JSON, or a text, with all text as a terminal may show it.

    In place of line ends, escape sequences and half characters stand a space and question marks.
    """
    if isinstance(value, dict):
        return {printable(name): printable(each) for name, each in value.items()}
    if isinstance(value, list):
        return [printable(each) for each in value]
    if not isinstance(value, str) or value.isprintable():
        return value
    return "".join(each if each.isprintable() else " " if each.isspace() else "?" for each in value)


def _wait_to_retry(give_up_s: float) -> None:
    if time.monotonic() + _RETRY_S > give_up_s:
        raise TimeoutError("no answer")
    time.sleep(_RETRY_S)


@contextlib.contextmanager
def _connected(path: Path, give_up_s: float) -> Iterator[socket.socket]:
    """Connect to the control socket at `path`; yield the connection, and close it at the end.

    The time left until monotonic `give_up_s` is the timeout of every call on the connection. Raises
    TimeoutError while too many clients wait, OSError if no face listens.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as client:
        client.settimeout(max(0.001, give_up_s - time.monotonic()))
        try:
            client.connect(str(path))
        except BlockingIOError as error:
            raise TimeoutError(errno.ETIMEDOUT, "it has too many clients") from error
        yield client


def _listens(path: Path) -> bool:
    """Return whether a process that we may reach listens at the socket `path`.

    A socket that refuses connections is removed if it is this user's (any user's for root) and no
    other process locks its folder.
    """
    if knock(path) == 0:
        return True
    if is_dead_socket(path):
        # Not removed while another process makes a socket there.
        with contextlib.suppress(ControlError, OSError), held_folder(path.parent, patience_s=0.0):
            if is_dead_socket(path):
                path.unlink(missing_ok=True)
    return False
