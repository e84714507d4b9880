"""Real `lipservo` processes at logged servos, and all that they say, with its times.

Statements are: each key of a status, each line on standard output and error, each answer on the
control socket, each exit status.
"""

import contextlib
import json
import os
import re
import subprocess
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from lipservo_lab.bench.statements.claims import Statement
from lipservo_lab.bench.stops.raw_control import Answer, connected, receive, request
from lipservo_lab.bench.stops.robot_at_port import RobotAtPort, kill_all, robot_at_port
from lipservo_lab.seen_processes import child_of

#: A status is asked for this often, whatever happens.
_POLL_S: Final = 0.12
_ANSWER_S: Final = 2.0
_LOOK_S: Final = 0.02
#: Twice as long as a face needs on a busy computer.
_COMES_S: Final = 60.0
_COMMAND_S: Final = 60.0
#: A mouth that is drawn with dots; what is said may stand behind it in the same line.
_DRAWN: Final = re.compile("[\u2800-\u28ff]+ *")
#: The confirmed end of a stop.
_END_S: Final = 12.0


class HeardFace:
    """A robot and the processes started at it, whose statements are all collected.

    statements: so far, of all processes. last_status: newest status of the face; {}: it did not
    answer. It is requested all the time, in a thread.
    """

    def __init__(self, robot: RobotAtPort) -> None:
        """Begin to request the status of what runs at `robot`."""
        self.robot = robot
        self.statements: list[Statement] = []
        self.last_status: Answer = {}
        self._is_over = threading.Event()
        self._readers: list[threading.Thread] = []
        self._poller = threading.Thread(target=self._poll_status, name="poll", daemon=True)
        self._poller.start()

    @property
    def first_servo(self) -> str:
        """The name of the face's first servo, which is critical where one is."""
        return next(iter(self.robot.settings.servos))

    @property
    def last_servo(self) -> str:
        """The name of the face's last servo."""
        return list(self.robot.settings.servos)[-1]

    def begin(self, *arguments: str) -> subprocess.Popen[bytes]:
        """Start `lipservo ARGUMENTS`; each line of its output becomes a statement."""
        began_s = time.monotonic()
        read_end, write_end = os.pipe()
        try:
            process = self.robot.start(*arguments, output=write_end)
        finally:
            os.close(write_end)
        reader = threading.Thread(target=self._read_lines, args=(read_end, began_s), daemon=True)
        reader.start()
        self._readers.append(reader)
        return process

    def begin_face(self, *arguments: str) -> subprocess.Popen[bytes]:
        """Start `daemon` or `run` at the servos."""
        command, *options = arguments
        where = ("--config", self.robot.config, "--port", str(self.robot.port))
        return self.begin(command, *where, *options)

    def command(self, *arguments: str, face_state: str = "") -> int:
        """Run `lipservo ARGUMENTS` to its end; return its exit status, which becomes a statement.

        face_state: words added to the command in that statement, where the status means something
        else for such a face.
        """
        began_s = time.monotonic()
        process = self.begin(*arguments)
        return self.wait_exit(process, " ".join((*arguments, face_state)).rstrip(), began_s)

    def wait_exit(self, process: subprocess.Popen[bytes], name: str, began_s: float = 0.0) -> int:
        """Wait for a process's end; return its exit status, which becomes a statement of `name`.

        began_s: when it was started. Raises TimeoutExpired after `_COMMAND_S`.
        """
        status = process.wait(_COMMAND_S)
        now_s = time.monotonic()
        self._add(f"exit {self._short(name)}: {status}", now_s, now_s, {"began_s": began_s})
        return status

    def send(self, word: str, *, until_end: bool = False) -> Answer:
        """Send a request to the control socket, once; return its answer, {} where there is none.

        The answer's parts become statements. until_end: wait for the report of a stop's end, whose
        parts become statements as well.
        """
        requested_s = time.monotonic()
        answer: Answer | None = None
        with contextlib.suppress(OSError), connected(self.control, requested_s + _END_S) as client:
            client.send(word.encode())
            answer = receive(client, requested_s + _ANSWER_S)
            self._add_all(f"answer to {word.split()[0]}", answer or {}, requested_s)
            if until_end and answer:
                end = receive(client, requested_s + _END_S)
                self._add_all(f"end of {word.split()[0]}", end or {}, time.monotonic())
        return answer or {}

    @property
    def control(self) -> Path:
        """The control socket of the face that was started last. Raises FileNotFoundError."""
        found = sorted(self.robot.controls, key=lambda each: each.stat().st_ctime)
        if not found:
            raise FileNotFoundError("no face has a control socket")
        return found[-1]

    def wait(self, seconds: float) -> None:
        """Let time pass; the status is requested in the background."""
        time.sleep(seconds)

    def wait_until(self, condition: Any, timeout_s: float = _COMES_S) -> bool:
        """Wait until `condition()` is true; return False if it is not within `timeout_s`."""
        give_up_s = time.monotonic() + timeout_s
        while not condition():
            if time.monotonic() > give_up_s:
                return False
            time.sleep(_LOOK_S)
        return True

    def wait_for_state(self, *states: str, timeout_s: float = _COMES_S) -> bool:
        """Wait until the status has one of these states; return whether it has in time."""
        return self.wait_until(lambda: self.last_status.get("state") in states, timeout_s)

    def wait_until_driven(self, timeout_s: float = _COMES_S) -> bool:
        """Wait until all servos hold, and the status says so; return whether that came in time."""
        held = self.wait_until(lambda: bool(self.robot.torque.all()), timeout_s)
        return held and self.wait_for_state("driven", timeout_s=timeout_s)

    def wait_until_limp(self, timeout_s: float = _COMES_S) -> bool:
        """Wait until no servo holds; return whether that came in time."""
        return self.wait_until(lambda: not self.robot.torque.any(), timeout_s)

    def child(self, daemon: subprocess.Popen[bytes], name: str) -> int:
        """Return the process id of the daemon's child "bridge" or "speech".

        Waits for one that is being replaced; raises RuntimeError where none comes.
        """
        if not self.wait_until(lambda: child_of(daemon.pid, f"{name}-process") is not None, 20.0):
            raise RuntimeError(f"no {name} process")
        return child_of(daemon.pid, f"{name}-process") or self.child(daemon, name)

    def close(self) -> None:
        """Stop requesting the status, and read the rest of all output."""
        self._is_over.set()
        self._poller.join()
        for reader in self._readers:
            reader.join(1.0)

    def _poll_status(self) -> None:
        """Request the status every `_POLL_S` until closed; its parts become statements.

        Runs in a thread. While no status is answered, `last_status` is empty.
        """
        while not self._is_over.wait(_POLL_S):
            requested_s = time.monotonic()
            with contextlib.suppress(OSError, ValueError):
                found = request(self.control, "status", _ANSWER_S)
                self._add_all("status", found, requested_s)
                self.last_status = found
                continue
            self.last_status = {}

    def _read_lines(self, read_end: int, began_s: float) -> None:
        """Turn the lines of a process's output into statements until its end; runs in a thread."""
        with os.fdopen(read_end, "rb") as lines:
            json_lines: list[str] = []
            for raw in lines:
                now_s = time.monotonic()
                line = _DRAWN.sub("", raw.decode(errors="replace")).rstrip()
                self._add_line(line, now_s, began_s, json_lines)

    def _add_line(self, line: str, now_s: float, began_s: float, json_lines: list[str]) -> None:
        """Add a line of output as a statement.

        JSON over several lines is collected in `json_lines`; once complete, its parts are added.
        """
        if line == "{" or (json_lines and line != "}"):
            json_lines.append(line)
            return
        if json_lines or (line.startswith("{") and line.endswith("}")):
            text = "\n".join([*json_lines, line])
            json_lines.clear()
            with contextlib.suppress(ValueError):
                parsed = json.loads(text)
                for face in parsed.get("faces", [parsed]):
                    kind = "status" if "state" in face and "pid" in face else "outcome"
                    self._add_all(kind, face, now_s)
                return
        if line.strip():
            self._add(f"says {line}", now_s, now_s, {"began_s": began_s})

    def _add_all(self, kind: str, found: Mapping[str, Any], requested_s: float) -> None:
        now_s = time.monotonic()
        for key, value in flattened(found):
            self._add(f"{kind} {key}: {value}", requested_s, now_s, found)

    def _add(self, text: str, since_s: float, until_s: float, about: Mapping[str, Any]) -> None:
        self.statements.append(Statement(text, since_s, until_s, about))

    def _short(self, name: str) -> str:
        """Return a command line with placeholders for this run's port, face and folder."""
        name = name.replace(str(self.robot.port), "PORT").replace(self.robot.config, "FACE")
        return name.replace(str(self.robot.folder), "FOLDER")


def flattened(found: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, str]]:
    """Yield each value of a JSON object with its path; items of a list have the list's path.

    An item with a name, as a servo's health, has the name in its path.
    """
    for key, value in found.items():
        path = f"{before}{key}"
        if isinstance(value, Mapping):
            yield from flattened(value, f"{path}.")
        elif isinstance(value, list):
            for item in value:
                if isinstance(item, Mapping):
                    name = f".{item['name']}" if "name" in item else ""
                    rest = {one: other for one, other in item.items() if one != "name"}
                    yield from flattened(rest, f"{path}{name}.")
                else:
                    yield path, json.dumps(item).strip('"') if not isinstance(item, str) else item
        else:
            yield path, value if isinstance(value, str) else json.dumps(value)


@contextlib.contextmanager
def heard_face(bus: str, *, critical: bool = False) -> Iterator[HeardFace]:
    """Yield a robot on a kind of bus, whose processes' statements are collected.

    All processes are killed afterwards. critical: the first servo is critical.
    """
    with robot_at_port(bus, critical=critical) as robot:
        face = HeardFace(robot)
        try:
            yield face
        finally:
            for process in robot.processes:
                kill_all(process)
            face.close()
