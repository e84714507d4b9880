"""What may go wrong around a stop: begun before it, and ended before the face is started again."""

import contextlib
import http.client
import io
import os
import signal
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from enum import StrEnum
from pathlib import Path
from typing import Final
from urllib.parse import urlencode, urlsplit

import numpy as np
import soundfile

from lipservo_lab.bench.stops import foreign_socket, pollers
from lipservo_lab.bench.stops.running_face import START_S, RunningFace, start_daemon
from lipservo_lab.seen_processes import children_of


class Trouble(StrEnum):
    """What has gone wrong when the stop comes."""

    RUNNING = "running"  # nothing
    UNPLUGGED = "unplugged"
    HUNG_BRIDGE = "hung_bridge"
    DEAD_SPEECH = "dead_speech"
    FROZEN = "frozen"
    DURING_REPLUG = "during_replug"
    DURING_RESTART = "during_restart"
    SECOND_FACE = "second_face"  # started at the same port, and refused
    NAME_SERVICE = "name_service"  # users are looked up in 4 s
    STATUS_RAISES = "status_raises"
    STATUS_HANGS = "status_hangs"
    SLOW_UPLOAD = "slow_upload"  # a line is uploaded to a disk that syncs in 4 s
    POLLERS = "pollers"  # 20 clients poll the status
    OTHER_DEAF = "other_deaf"  # a servo of another face does not answer
    OTHER_UNPLUGGED = "other_unplugged"
    OTHER_HUNG = "other_hung"  # all processes of another face
    FOREIGN_SILENT = "foreign_silent"  # a socket beside ours that never answers
    FOREIGN_ENDLESS = "foreign_endless"  # one that accepts the stop and never ends
    CLOCK_JUMPS = "clock_jumps"  # by a day, there and back
    EASING = "easing"  # a soft stop is under way
    STARTING = "starting"  # the daemon has just been launched
    START_AGAIN = "start_again"  # a stopped face has just been started
    START_AFTER_STOP = "start_after_stop"  # a start comes while it stops
    START_AT_ONCE = "start_at_once"  # another client sends a start in the same moment
    EVERYBODY_KILLED = "everybody_killed"  # bridge and supervisor at once, by kill -9


#: The conditions of this campaign from its beginning, each at three moments.
FIRST_TROUBLES: Final = tuple(Trouble)[:8]
#: Those in which every client requests every stop.
FOR_EVERY_CLIENT: Final = tuple(Trouble)[8:17]
#: A start and a stop that meet; none of them can be where the word `start` is not known.
NEED_START: Final = (Trouble.START_AGAIN, Trouble.START_AFTER_STOP, Trouble.START_AT_ONCE)
_OTHERS: Final = (Trouble.OTHER_DEAF, Trouble.OTHER_UNPLUGGED, Trouble.OTHER_HUNG)
_INJECTED: Final = {
    Trouble.NAME_SERVICE: "name_service",
    Trouble.STATUS_RAISES: "status_raises",
    Trouble.STATUS_HANGS: "status_hangs",
    Trouble.CLOCK_JUMPS: "clock",
}
#: The plug is out for so long after the stop.
PLUG_OUT_S: Final = 1.5
_UPLOAD_S: Final = 20.0
_COMES_S: Final = 5.0


def n_others(trouble: Trouble) -> int:
    """Return how many other faces a trouble needs beside the one under test."""
    return int(trouble in _OTHERS)


def needs_page(trouble: Trouble) -> bool:
    """Return whether a trouble needs the face's page."""
    return trouble in (Trouble.SLOW_UPLOAD, Trouble.POLLERS)


def needs_agents(trouble: Trouble) -> bool:
    """Return whether a trouble needs the face's agent server; a face's lines need it, too."""
    return needs_page(trouble)


@contextlib.contextmanager
def gone_wrong(trouble: Trouble, face: RunningFace) -> Iterator[float]:
    """Let a trouble last until the block ends; yield the monotonic time at which it has begun.

    What cannot be undone, such as a killed process, is not. Raises RuntimeError, OSError.
    """
    with ExitStack() as undo:
        _begin_trouble(trouble, face, undo)
        yield time.monotonic()


def _begin_trouble(trouble: Trouble, face: RunningFace, undo: ExitStack) -> None:
    """Begin a trouble at a running face; put what ends it again, if anything, on `undo`.

    Blocks until the trouble is there. Raises RuntimeError where it cannot be made.
    """
    robot = face.robot
    if trouble in _INJECTED:
        _inject(face, _INJECTED[trouble], undo)
    match trouble:
        case Trouble.UNPLUGGED:
            robot.device.unplug()
            undo.callback(robot.device.plug_in)
        case Trouble.HUNG_BRIDGE:
            os.kill(face.child("bridge"), signal.SIGSTOP)
        case Trouble.DEAD_SPEECH:
            os.kill(face.child("speech"), signal.SIGKILL)
        case Trouble.FROZEN:
            face.request("freeze")
        case Trouble.DURING_REPLUG:
            robot.device.unplug()
            robot.look(1.0)
            robot.device.plug_in()
        case Trouble.DURING_RESTART:
            os.kill(face.child("bridge"), signal.SIGKILL)
        case Trouble.EVERYBODY_KILLED:
            for pid in (face.daemon.pid, face.child("bridge")):
                os.kill(pid, signal.SIGKILL)
            face.daemon.wait()
        case Trouble.SECOND_FACE:
            second = start_daemon(robot, "--listen", "none")
            if not robot.look_until(lambda: second.poll() is not None, START_S):
                raise RuntimeError("a second face at a port that is in use does not end")
            if second.poll() == 0:
                raise RuntimeError("a second face was started at a port that is in use")
        case Trouble.SLOW_UPLOAD:
            _inject(face, "disk", undo)
            _upload_slowly(face)
        case Trouble.POLLERS:
            at = face.at
            arguments = (str(at.control), at.page, at.agents, face.token)
            _start_beside(face, undo, "-m", pollers.__name__, *arguments)
            robot.look(2.0)
        case Trouble.OTHER_DEAF:
            servo = face.others[0].robot.chain.servos[0]
            servo.ignore_until(float("inf"))
            robot.look(0.3)
        case Trouble.OTHER_UNPLUGGED:
            face.others[0].robot.device.unplug()
            robot.look(0.5)
        case Trouble.OTHER_HUNG:
            other = face.others[0].daemon.pid
            for pid in (*children_of(other), other):
                os.kill(pid, signal.SIGSTOP)
        case Trouble.FOREIGN_SILENT | Trouble.FOREIGN_ENDLESS:
            _start_foreign_socket(face, trouble.removeprefix("foreign_"), undo)
        case Trouble.EASING:
            face.request("soft")


def _inject(face: RunningFace, name: str, undo: ExitStack) -> None:
    """Switch an injected trouble on by its flag file; put its end on `undo`."""
    flag = face.inject / name
    flag.touch()
    undo.callback(flag.unlink, missing_ok=True)


def _upload_slowly(face: RunningFace) -> None:
    """Begin to upload a line in a thread; return once the face writes its bytes to the disk.

    Raises RuntimeError where it does not.
    """
    reached_disk = face.inject / "seen.disk"
    reached_disk.unlink(missing_ok=True)

    def post_sound() -> None:
        """Upload a sound to the page's `/api/lines` and ignore all errors; runs in a thread."""
        connection = http.client.HTTPConnection(urlsplit(face.at.page).netloc, timeout=_UPLOAD_S)
        with contextlib.closing(connection), contextlib.suppress(OSError):
            name = urlencode({"name": "upload.wav", "replace": "true"})
            headers = {"Authorization": f"Bearer {face.token}"} if face.token else {}
            body = _noise_wav()
            connection.request("POST", f"/api/lines?{name}", body, headers)
            connection.getresponse().read()

    threading.Thread(target=post_sound, daemon=True).start()
    if not face.robot.look_until(reached_disk.exists, _COMES_S):
        raise RuntimeError("the upload did not come to the disk")


def _noise_wav() -> bytes:
    file = io.BytesIO()
    noise = np.random.default_rng(0).normal(0.0, 0.1, 16_000)
    soundfile.write(file, noise, 16_000, format="WAV")
    return file.getvalue()


def _start_foreign_socket(face: RunningFace, kind: str, undo: ExitStack) -> None:
    """Run a foreign program whose socket lies where our faces' sockets are, until `undo`.

    kind: as of `foreign_socket`. The program is given by standard input, so that its command line
    has no name of ours. Raises RuntimeError where the socket does not appear.
    """
    robot = face.robot
    before = set(robot.controls)
    robot.environment[foreign_socket.FOLDER_VARIABLE] = str(robot.runtime)
    try:
        process = robot.start_python("-", kind, stdin=subprocess.PIPE)
    finally:
        del robot.environment[foreign_socket.FOLDER_VARIABLE]
    undo.callback(_end_process, face, process)
    assert process.stdin is not None
    process.stdin.write(Path(foreign_socket.__file__).read_bytes())
    process.stdin.close()
    if not robot.look_until(lambda: set(robot.controls) > before, _COMES_S):
        raise RuntimeError("the foreign socket was not made")
    for path in set(robot.controls) - before:
        undo.callback(path.unlink, missing_ok=True)


def _start_beside(face: RunningFace, undo: ExitStack, *arguments: str) -> None:
    undo.callback(_end_process, face, face.robot.start_python(*arguments))


def _end_process(face: RunningFace, process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()
    face.robot.processes.remove(process)
