"""Stops against everything that may go wrong around them, on real processes and simulated servos.

A daemon speaks through a serial port of simulated servos that live in this process, so that torque
and shafts are seen as they are, whatever anybody says of them. Then something goes wrong, a person
stops the face at some moment of it, and what happened afterwards is looked at.
"""

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.control_client import ask, stop_and_wait
from firmware_bridge.dynamixel.mounting import PULSES_PER_TURN
from firmware_bridge.simulator.chain import SimulatedChain
from firmware_bridge.simulator.face import chain_for
from firmware_bridge.simulator.pty_host import PtyHost
from firmware_bridge.stopping import StopLevel
from lipservo.servos import mounted_servos
from lipservo.settings import load_shipped_face

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
FACE: Final = "face_four"

_BAUD_RATE: Final = 1_000_000
#: A daemon is awake when all its servos hold; it takes seconds on a busy machine.
_AWAKE_S: Final = 60.0
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
_LOOK_S: Final = 0.005


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


@dataclass(slots=True)
class _Robot:
    """Simulated servos at a port, and the daemon that drives them."""

    chain: SimulatedChain
    link: Path
    control: Path
    daemon: subprocess.Popen[bytes]
    log: Path
    #: (time, torque, positions) every 5 ms.
    seen: list[tuple[float, NDArray[np.bool_], NDArray[np.float64]]] = field(default_factory=list)

    @property
    def torque(self) -> NDArray[np.bool_]:
        return self.chain.motors.torque_on.copy()

    def look(self, seconds: float) -> None:
        """Watch the servos for a while."""
        until_s = time.monotonic() + seconds
        while (now_s := time.monotonic()) < until_s:
            self.seen.append((now_s, self.torque, self.chain.motors.position.copy()))
            time.sleep(_LOOK_S)

    def child(self, name: str) -> int:
        """The process id of the bridge or the speech process."""
        pids = Path(f"/proc/{self.daemon.pid}/task/{self.daemon.pid}/children").read_text().split()
        for pid in map(int, pids):
            if f"{name}-process" in Path(f"/proc/{pid}/cmdline").read_text():
                return pid
        raise RuntimeError(f"no {name} process: {self.log.read_text()[-2000:]}")


def play_stop(case: StopCase) -> StopOutcome:
    """Play one case to its end; takes some fifteen seconds."""
    outcome = StopOutcome(case)
    try:
        with _speaking_robot() as robot:
            _play(case, robot, outcome)
    except (OSError, RuntimeError) as error:
        outcome.error = f"{type(error).__name__}: {error}"
    return outcome


def _play(case: StopCase, robot: _Robot, outcome: StopOutcome) -> None:
    reachable_s = _go_wrong(case, robot)
    robot.look(case.moment_s)
    stopped_s = time.monotonic()
    waiting = _stop(case, robot)
    if case.condition == "unplugged":
        robot.look(_PLUG_OUT_S)
        robot.chain.plug_in()
        reachable_s = time.monotonic()
    since_s = max(stopped_s, reachable_s)
    if case.level is StopLevel.FREEZE:
        _judge_frozen(robot, since_s, outcome)
    else:
        _judge_limp(robot, stopped_s, since_s, outcome)
    waiting.join(0.0)


def _go_wrong(case: StopCase, robot: _Robot) -> float:
    """Bring the condition about; from when on the servos can be reached."""
    if case.condition == "unplugged":
        robot.chain.unplug()
    elif case.condition == "hung_bridge":
        os.kill(robot.child("bridge"), signal.SIGSTOP)
    elif case.condition == "dead_speech":
        os.kill(robot.child("speech"), signal.SIGKILL)
    elif case.condition == "frozen":
        stop_and_wait(robot.control, StopLevel.FREEZE, 5.0)
    elif case.condition == "during_replug":
        robot.chain.unplug()
        robot.look(1.0)
        robot.chain.plug_in()
    elif case.condition == "during_restart":
        os.kill(robot.child("bridge"), signal.SIGKILL)
    elif case.condition == "second_face":
        second = _start_daemon(robot.link, robot.control.with_name("second.sock"), robot.log)
        if second.wait(_AWAKE_S) == 0:
            raise RuntimeError("a second face was started at a port that is in use")
    return time.monotonic()


def _stop(case: StopCase, robot: _Robot) -> threading.Thread:
    """Ask for the stop without waiting for its end."""

    def by_socket() -> None:
        with contextlib.suppress(OSError):
            stop_and_wait(robot.control, case.level, 30.0, 10.0)

    def by_signal() -> None:
        robot.daemon.send_signal(signal.SIGTERM)
        if case.level is StopLevel.LIMP:
            time.sleep(0.05)
            robot.daemon.send_signal(signal.SIGTERM)

    asking = threading.Thread(target=by_socket if case.way == "socket" else by_signal, daemon=True)
    asking.start()
    return asking


def _judge_limp(robot: _Robot, stopped_s: float, since_s: float, outcome: StopOutcome) -> None:
    robot.look(max(0.0, since_s + _LIMP_WITHIN_S - time.monotonic()))
    outcome.torque_left_on = int(robot.torque.sum())
    robot.look(_WATCH_S)
    outcome.torque_left_on = max(outcome.torque_left_on, int(robot.torque.sum()))
    for earlier, later in zip(robot.seen, robot.seen[1:], strict=False):
        if earlier[0] > stopped_s + _BRAKES_S:
            outcome.undone += int((later[1] & ~earlier[1]).sum())
    stiff_s = [time_s for time_s, torque, _ in robot.seen if torque.any() and time_s > since_s]
    outcome.limp_after_s = stiff_s[-1] - since_s if stiff_s else 0.0


def _judge_frozen(robot: _Robot, since_s: float, outcome: StopOutcome) -> None:
    """Held or limp, but where it was; what ails a servo meanwhile is told; nobody gets torque."""
    robot.look(max(0.0, since_s + _BRAKES_S - time.monotonic()))
    first = len(robot.seen)
    robot.look(_WATCH_S)
    watched = robot.seen[first:]
    places = np.array([places for _, _, places in watched])
    moved_deg = np.ptp(places, axis=0) / PULSES_PER_TURN * 360.0
    outcome.moved_frozen = int((moved_deg > _STILL_DEG).sum())
    torque = np.array([torque for _, torque, _ in watched])
    outcome.undone = int((torque[1:] & ~torque[:-1]).sum())
    robot.chain.servos[0].latch(0x10)
    give_up_s = time.monotonic() + _TOLD_S
    while time.monotonic() < give_up_s:
        with contextlib.suppress(OSError):
            answer = ask(robot.control, "status")
            if "shock" in " ".join(map(str, answer.get("troubles", []))):
                return
        robot.look(0.1)
    outcome.fault_unseen = 1


@contextlib.contextmanager
def _speaking_robot() -> Iterator[_Robot]:
    """A daemon that has woken all its servos and moves them."""
    servos = mounted_servos(load_shipped_face(FACE))
    with tempfile.TemporaryDirectory(prefix="lipservo-stops-") as folder:
        link, control, log = (Path(folder) / name for name in ("port", "control.sock", "log"))
        chain = chain_for(servos, _BAUD_RATE)
        host = PtyHost(chain, link)
        over = threading.Event()
        serving = threading.Thread(target=host.serve, args=(over.is_set,), daemon=True)
        serving.start()
        robot = _Robot(chain, link, control, _start_daemon(link, control, log), log)
        try:
            _wait_until_driven(robot)
            yield robot
        finally:
            _kill(robot.daemon)
            over.set()
            serving.join()
            host.close()


def _start_daemon(link: Path, control: Path, log: Path) -> subprocess.Popen[bytes]:
    clip = Path(__file__).with_name("clips") / "welcome.flac"
    command = [sys.executable, "-m", "lipservo", "daemon", "--config", FACE, "--port", str(link)]
    command += ["--control", str(control), "--wav", str(clip)]
    with log.open("ab") as file:
        return subprocess.Popen(command, stdout=file, stderr=file, stdin=subprocess.DEVNULL)


def _wait_until_driven(robot: _Robot) -> None:
    give_up_s = time.monotonic() + _AWAKE_S
    while not robot.torque.all():
        if time.monotonic() > give_up_s or robot.daemon.poll() is not None:
            raise RuntimeError(f"the face did not wake: {robot.log.read_text()[-2000:]}")
        time.sleep(0.02)
    robot.look(1.0)  # into the soft start and the first words


def _kill(daemon: subprocess.Popen[bytes]) -> None:
    """Whatever is left of it, children that hang included."""
    with contextlib.suppress(OSError):
        children = f"/proc/{daemon.pid}/task/{daemon.pid}/children"
        for pid in Path(children).read_text().split():
            os.kill(int(pid), signal.SIGKILL)
    daemon.kill()
    daemon.wait()


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
