"""A daemon at simulated servos that speaks, with what a campaign does to it and reads of it."""

import contextlib
import http.client
import os
import re
import shutil
import subprocess
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any, Final
from urllib.parse import urlsplit

import lipservo
from lipservo_lab.bench.stops import injected, traced
from lipservo_lab.bench.stops.raw_control import request
from lipservo_lab.bench.stops.robot_at_port import (
    CLIP,
    FACE,
    RobotAtPort,
    robot_at_port,
)
from lipservo_lab.bench.stops.stop_clients import Addresses
from lipservo_lab.seen_processes import child_of

#: A daemon has started when all its servos hold; it takes seconds on a busy machine.
START_S: Final = 60.0
_ANSWER_S: Final = 2.0
_POLL_S: Final = 0.2
#: A process that died is replaced by then.
_REPLACED_S: Final = 20.0
#: A start may be refused for so long after a stop was confirmed.
_REFUSED_S: Final = 20.0
#: Of the runtime folder; that programs of this computer find by themselves.
_TOKEN: Final = "token"
#: The folder that our packages lie in.
_ROOT: Final = Path(lipservo.__file__).parents[1]
_PAGE: Final = re.compile(r"dashboard: (http://[\d.]+:\d+)")
_AGENTS: Final = re.compile(r"voice agents: (ws://[\d.]+:\d+)")


@dataclass(slots=True)
class RunningFace:
    """A daemon, the robot that it drives, and the addresses at which it can be reached.

    token: that its servers require; empty: none. others: further robots, with a daemon each. spent:
    no further case can be played on it.
    """

    robot: RobotAtPort
    daemon: subprocess.Popen[bytes]
    at: Addresses
    token: str = ""
    others: list["RunningFace"] = field(default_factory=list)
    spent: bool = False

    @property
    def inject(self) -> Path:
        """The folder whose files switch injected troubles on."""
        return self.robot.folder / "inject"

    def child(self, name: str) -> int:
        """Return the process id of the daemon's child, "bridge" or "speech".

        Waits for a child that is being replaced; raises RuntimeError where none comes.
        """
        process_name, pid = f"{name}-process", self.daemon.pid
        if not self.robot.look_until(lambda: child_of(pid, process_name) is not None, _REPLACED_S):
            raise RuntimeError(f"no {name} process: {self.robot.last_output}")
        return child_of(pid, process_name) or self.child(name)

    def request(self, word: str) -> dict[str, Any]:
        """Send a request to the control socket; return its answer. Raises OSError.

        The servos are watched meanwhile.
        """
        with ThreadPoolExecutor(1) as pool:
            answer: Future[dict[str, Any]] = pool.submit(request, self.at.control, word, _ANSWER_S)
            self.robot.look_until(answer.done, 2.0 * _ANSWER_S)
            return answer.result()

    def status(self) -> dict[str, Any]:
        """Return the face's status; {} where it does not answer."""
        with contextlib.suppress(OSError):
            return self.request("status")
        return {}

    def knows_start(self) -> bool:
        """Return whether this program has a start after a stop, without sending a start."""
        return "can_start" in self.status()

    def start_again(self) -> dict[str, Any]:
        """Send `start` until it is accepted, for `_REFUSED_S` at most; return the last answer.

        A face that releases its servos once more, or whose bridge is being replaced, refuses it
        meanwhile. {}: there was no answer.
        """
        give_up_s = time.monotonic() + _REFUSED_S
        while True:
            answer = {}
            with contextlib.suppress(OSError):
                answer = self.request("start")
            if "accepted" in answer or time.monotonic() > give_up_s:
                return answer
            self.robot.look(_POLL_S)

    def look_until_state(self, state: str, timeout_s: float) -> bool:
        """Watch until the status has this state; return whether it came.

        False after `timeout_s`, or once the daemon has ended.
        """
        give_up_s = time.monotonic() + timeout_s
        while time.monotonic() < give_up_s and self.daemon.poll() is None:
            if self.status().get("state") == state:
                return True
            self.robot.look(_POLL_S)
        return False


@contextlib.contextmanager
def running_face(
    *,
    bus: str = "dynamixel",
    page: bool = False,
    agents: bool = False,
    n_others: int = 0,
    tracer: ModuleType | None = None,
    face: str = FACE,
    sound: Path = CLIP,
) -> Iterator[RunningFace]:
    """Start a daemon at simulated servos; yield the face once it speaks and drives all servos.

    page, agents: it serves a dashboard, voice agents. n_others: silent faces that are started
    first, so that programs list them first. tracer: module loaded into its processes in place of
    `injected`. face: name of a shipped one; sound: file that it speaks. Raises RuntimeError where a
    face does not start.
    """
    with ExitStack() as stack:
        robot = stack.enter_context(robot_at_port(bus, face=face))
        others = []
        for _ in range(n_others):
            other_robot = stack.enter_context(robot_at_port(session=robot.session))
            others.append(_start_face(other_robot, "--listen", "none"))
        if tracer is not None:
            robot.environment[traced.ROOT_VARIABLE] = str(_ROOT)
        options = ["--wav", str(sound), "--listen", "127.0.0.1:0" if agents else "none"]
        if page:
            options += ["--dashboard", "--dashboard-listen", "127.0.0.1:0"]
        running = _start_face(robot, *options, module=tracer or injected)
        running.others = others
        running.at = _find_addresses(running, page=page, agents=agents)
        with contextlib.suppress(FileNotFoundError):
            running.token = (robot.runtime / _TOKEN).read_text().strip()
        robot.look(1.0)  # into the soft start and the first words
        yield running


def start_daemon(
    robot: RobotAtPort, *options: str, module: ModuleType = injected
) -> subprocess.Popen[bytes]:
    """Start a daemon of the robot's face, each process of which loads `module` first."""
    inject = robot.folder / "inject"
    inject.mkdir(exist_ok=True)
    shutil.copyfile(str(module.__file__), inject / "sitecustomize.py")
    robot.environment[injected.FOLDER_VARIABLE] = str(inject)
    paths = (str(inject), os.environ.get("PYTHONPATH", ""))
    robot.environment["PYTHONPATH"] = os.pathsep.join(each for each in paths if each)
    where = ["--config", robot.config, "--port", str(robot.port)]
    return robot.start("daemon", *where, *options)


def _start_face(robot: RobotAtPort, *options: str, module: ModuleType = injected) -> RunningFace:
    """Start a daemon; return its face once all servos have torque. Raises RuntimeError."""
    daemon = start_daemon(robot, *options, module=module)
    came = robot.look_until(lambda: bool(robot.torque.all()) or daemon.poll() is not None, START_S)
    control = next((each for each in robot.controls if f"-{daemon.pid}." in each.name), None)
    if not came or control is None or daemon.poll() is not None:
        raise RuntimeError(f"the servos were not enabled: {robot.last_output}")
    return RunningFace(robot, daemon, Addresses(control))


def _find_addresses(face: RunningFace, *, page: bool, agents: bool) -> Addresses:
    """Return the addresses of a face's servers from its output, once they answer.

    Raises RuntimeError where one does not.
    """
    pattern_of = {"page": _PAGE} if page else {}
    pattern_of |= {"agents": _AGENTS} if agents else {}
    address_of: dict[str, str] = {}
    for name, pattern in pattern_of.items():
        match = _match_in_output(face, pattern)
        if match is None:
            raise RuntimeError(f"no address of its {name}: {face.robot.last_output}")
        address_of[name] = match[1]
    at = Addresses(face.at.control, **address_of)
    if page and not face.robot.look_until(lambda: _page_answers(at.page), START_S):
        raise RuntimeError(f"its page does not answer: {face.robot.last_output}")
    return at


def _match_in_output(face: RunningFace, pattern: re.Pattern[str]) -> re.Match[str] | None:
    """Wait for a pattern in the face's output; return the match, None if it has not come."""
    face.robot.look_until(lambda: pattern.search(face.robot.output) is not None, START_S)
    return pattern.search(face.robot.output)


def _page_answers(page: str) -> bool:
    with contextlib.suppress(OSError, http.client.HTTPException):
        connection = http.client.HTTPConnection(urlsplit(page).netloc, timeout=0.3)
        with contextlib.closing(connection):
            connection.request("GET", "/api/status")
            return connection.getresponse().status > 0
    return False
