"""Stops against everything that may go wrong around them, on real processes and simulated servos.

A daemon speaks through a serial port of simulated servos that live in this process, so that torque
and shafts are seen as they are, whatever anybody says of them. Then something goes wrong, a person
stops the face at some moment of it, and what happened afterwards is looked at.
"""

import contextlib
import os
import signal
import subprocess
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Final

import numpy as np

from firmware_bridge.process.control_client import ask, stop_and_wait
from firmware_bridge.stopping import StopLevel
from lipservo.bench.robot_at_port import CLIP, FACE, RobotAtPort, children_of, robot_at_port

CONDITIONS: Final = (
    "running",
    "unplugged",
    "hung_bridge",
    "dead_speech",
    "frozen",
    "during_replug",
    "during_restart",
    "second_face",
)
#: After what has gone wrong, the stop comes so much later, seconds.
MOMENTS_S: Final = (0.0, 0.15, 0.6)
#: Who stops: a client of the control socket, or a signal to the daemon (two of them: limp).
WAYS: Final = ("socket", "signal")

#: A daemon has started when all its servos hold; it takes seconds on a busy machine.
_START_S: Final = 60.0
#: The plug is out for so long after the stop.
_PLUG_OUT_S: Final = 1.5
#: Torque must be off so long after the servos can be reached again.
_LIMP_WITHIN_S: Final = 2.0
#: After that, and after a freeze, everything is watched for so much longer.
_WATCH_S: Final = 4.0
#: A frozen face brakes first; then no shaft may move by more than this.
_BRAKES_S, _STILL_DEG = 0.4, 1.0
#: A fault of a frozen servo must be told within this time.
_TOLD_S: Final = 6.0


@dataclass(frozen=True, slots=True)
class StopCase:
    """One stop: how hard, what went wrong before it, how much later it came, and by whom."""

    level: StopLevel
    condition: str
    moment_s: float
    way: str


@dataclass(slots=True)
class StopOutcome:
    """What came of it.

    torque_left_on: servos that held 2 s after they could be reached. undone: servos that got
    torque, or speech's motion, although a person had stopped the face. moved_frozen: shafts that
    moved. fault_unseen: a fault that the status of a frozen face did not tell. error: the case
    itself did not work.
    """

    case: StopCase
    torque_left_on: int = 0
    undone: int = 0
    moved_frozen: int = 0
    fault_unseen: int = 0
    limp_after_s: float | None = None
    error: str = ""

    @property
    def kept(self) -> bool:
        """Whether the promise was kept."""
        bad = self.torque_left_on + self.undone + self.moved_frozen + self.fault_unseen
        return not (self.error or bad)


def stop_cases() -> Iterator[StopCase]:
    """Every level, condition, moment and way; nobody freezes a face by a signal."""
    for level, condition, moment_s, way in product(StopLevel, CONDITIONS, MOMENTS_S, WAYS):
        if not (level is StopLevel.FREEZE and way == "signal"):
            yield StopCase(level, condition, moment_s, way)


@dataclass(frozen=True, slots=True)
class _Face:
    """A daemon that speaks, and the robot that it drives."""

    robot: RobotAtPort
    daemon: subprocess.Popen[bytes]

    @property
    def control(self) -> Path:
        return self.robot.folder / "control.sock"

    def child(self, name: str) -> int:
        """The process id of the bridge or the speech process."""
        for pid in children_of(self.daemon.pid):
            if f"{name}-process" in Path(f"/proc/{pid}/cmdline").read_text():
                return pid
        raise RuntimeError(f"no {name} process: {self.robot.last_said}")


def play_stop(case: StopCase) -> StopOutcome:
    """Play one case to its end; takes some fifteen seconds."""
    outcome = StopOutcome(case)
    try:
        with _speaking_face() as face:
            _play(case, face, outcome)
    except (OSError, RuntimeError) as error:
        outcome.error = f"{type(error).__name__}: {error}"
    return outcome


def _play(case: StopCase, face: _Face, outcome: StopOutcome) -> None:
    robot = face.robot
    reachable_s = _go_wrong(case, face)
    robot.look(case.moment_s)
    stopped_s = time.monotonic()
    waiting = _stop(case, face)
    if case.condition == "unplugged":
        robot.look(_PLUG_OUT_S)
        robot.chain.plug_in()
        reachable_s = time.monotonic()
    since_s = max(stopped_s, reachable_s)
    if case.level is StopLevel.FREEZE:
        _judge_frozen(face, since_s, outcome)
    else:
        _judge_limp(robot, stopped_s, since_s, outcome)
    waiting.join(0.0)


def _go_wrong(case: StopCase, face: _Face) -> float:
    """Bring the condition about; from when on the servos can be reached."""
    robot = face.robot
    if case.condition == "unplugged":
        robot.chain.unplug()
    elif case.condition == "hung_bridge":
        os.kill(face.child("bridge"), signal.SIGSTOP)
    elif case.condition == "dead_speech":
        os.kill(face.child("speech"), signal.SIGKILL)
    elif case.condition == "frozen":
        stop_and_wait(face.control, StopLevel.FREEZE, 5.0)
    elif case.condition == "during_replug":
        robot.chain.unplug()
        robot.look(1.0)
        robot.chain.plug_in()
    elif case.condition == "during_restart":
        os.kill(face.child("bridge"), signal.SIGKILL)
    elif case.condition == "second_face":
        second = _start_daemon(robot, "second.sock")
        if second.wait(_START_S) == 0:
            raise RuntimeError("a second face was started at a port that is in use")
    return time.monotonic()


def _stop(case: StopCase, face: _Face) -> threading.Thread:
    """Ask for the stop without waiting for its end."""

    def by_socket() -> None:
        with contextlib.suppress(OSError):
            stop_and_wait(face.control, case.level, 30.0, 10.0)

    def by_signal() -> None:
        face.daemon.send_signal(signal.SIGTERM)
        if case.level is StopLevel.LIMP:
            time.sleep(0.05)
            face.daemon.send_signal(signal.SIGTERM)

    asking = threading.Thread(target=by_socket if case.way == "socket" else by_signal, daemon=True)
    asking.start()
    return asking


def _judge_limp(robot: RobotAtPort, stopped_s: float, since_s: float, outcome: StopOutcome) -> None:
    robot.look(max(0.0, since_s + _LIMP_WITHIN_S - time.monotonic()))
    outcome.torque_left_on = int(robot.torque.sum())
    robot.look(_WATCH_S)
    outcome.torque_left_on = max(outcome.torque_left_on, int(robot.torque.sum()))
    outcome.undone = robot.switched_on(stopped_s + _BRAKES_S)
    outcome.limp_after_s = robot.stiff_until_s(since_s)


def _judge_frozen(face: _Face, since_s: float, outcome: StopOutcome) -> None:
    """Held or limp, but where it was; trouble of a servo meanwhile is told; nobody gets torque."""
    robot = face.robot
    robot.look(max(0.0, since_s + _BRAKES_S - time.monotonic()))
    watched_s = time.monotonic()
    robot.look(_WATCH_S)
    outcome.moved_frozen = int((robot.moved_deg(watched_s) > _STILL_DEG).sum())
    outcome.undone = robot.switched_on(watched_s)
    robot.chain.servos[0].latch(0x10)
    give_up_s = time.monotonic() + _TOLD_S
    while time.monotonic() < give_up_s:
        with contextlib.suppress(OSError):
            answer = ask(face.control, "status")
            if "shock" in " ".join(map(str, answer.get("troubles", []))):
                return
        robot.look(0.1)
    outcome.fault_unseen = 1


@contextlib.contextmanager
def _speaking_face() -> Iterator[_Face]:
    """A daemon that has enabled all its servos and moves them."""
    with robot_at_port() as robot:
        face = _Face(robot, _start_daemon(robot, "control.sock"))
        started = robot.look_until(
            lambda: bool(robot.torque.all()) or face.daemon.poll() is not None, _START_S
        )
        if not started or face.daemon.poll() is not None:
            raise RuntimeError(f"the servos were not enabled: {robot.last_said}")
        robot.look(1.0)  # into the soft start and the first words
        yield face


def _start_daemon(robot: RobotAtPort, control: str) -> subprocess.Popen[bytes]:
    where = ["--port", str(robot.port), "--control", str(robot.folder / control)]
    return robot.start("daemon", "--config", FACE, *where, "--wav", str(CLIP))


def stop_figures(outcomes: Sequence[StopOutcome]) -> dict[str, float | int]:
    """The figures of the campaign."""
    limp_s = [o.limp_after_s for o in outcomes if o.limp_after_s is not None]
    return {
        "cases": len(outcomes),
        "kept": sum(o.kept for o in outcomes),
        "torque_left_on": sum(o.torque_left_on for o in outcomes),
        "moved_frozen": sum(o.moved_frozen for o in outcomes),
        "faults_unseen": sum(o.fault_unseen for o in outcomes),
        "undone": sum(o.undone for o in outcomes),
        "errors": sum(bool(o.error) for o in outcomes),
        "limp_after_p95_s": float(np.percentile(limp_s, 95)) if limp_s else 0.0,
        "limp_after_worst_s": max(limp_s, default=0.0),
    }
