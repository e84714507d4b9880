"""Signals against every command that can move servos, on real processes and simulated servos.

A command works at a serial port whose servos live in this process. It is ended in some way at some
moment, and then servos, exit status and what it says are looked at.

Every command that can move servos, and every way to end it: what the signal campaign plays.
"""

import contextlib
import itertools
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Final

import numpy as np
import soundfile

from firmware_bridge.process.control_client import stop_and_wait
from firmware_bridge.stop_signals import STOP_SIGNALS
from firmware_bridge.stopping import ExitStatus, StopLevel
from lipservo_lab.bench.stops.robot_at_port import CLIP, FACE, RobotAtPort, kill_all, robot_at_port
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.face.model import load_face
from lipsync.offline.performance import RATE_HZ, Performance, performed_sound, write_performance


class Moment(StrEnum):
    """When the signal comes, and what is wrong by then."""

    STARTING = "starting"  # before any torque
    OPENING_SOUND = "opening_sound"  # while the sound file is examined
    WORKING = "working"  # servos hold, or are being written to
    UNPLUGGED = "unplugged"  # the plug was pulled while they held
    DEAF = "deaf"  # one servo hears nothing any more


class Ending(StrEnum):
    """By what a command is ended."""

    INT = "INT"
    TERM = "TERM"
    HUP = "HUP"
    QUIT = "QUIT"
    KILL = "KILL"  # of the process and its children at once
    STOP = "stop"  # asked for at its socket, as `lipservo stop` does


SIGNALS: Final = (Ending.INT, Ending.TERM, Ending.HUP, Ending.QUIT)


@dataclass(frozen=True, slots=True)
class Command:
    """A command of `lipservo` to be ended at simulated servos.

    arguments: returns its command line for a robot. prepare: brings the robot's servos and files
    into the state needed before. answers: for its questions, on standard input. own_servos: it
    simulates servos of its own, so that only its output can be checked.
    """

    name: str
    arguments: Callable[[RobotAtPort], list[str]]
    prepare: Callable[[RobotAtPort], None] = lambda _: None
    answers: str = ""
    own_servos: bool = False
    #: `setup-servos` never switches torque on, so that there is nothing to stop.
    arms: bool = True
    #: A service manager takes any status but 0 for a failure.
    ends_well: bool = False


@dataclass(frozen=True, slots=True)
class SignalCase:
    """One command, ended in one way at one moment. twice: the signal comes again 0.1 s later.

    then: what releases the servos after a KILL, "limp" or "start" (of another command). delay_s:
    from the launch to the signal, for `Moment.STARTING`.
    """

    command: str
    ending: Ending
    moment: Moment = Moment.WORKING
    twice: bool = False
    then: str = ""
    delay_s: float = 0.0


def _at_port(*arguments: str) -> Callable[[RobotAtPort], list[str]]:
    return lambda robot: [*arguments, "--config", FACE, "--port", str(robot.port)]


def _calibrate(step: str, *arguments: str) -> Callable[[RobotAtPort], list[str]]:
    def arguments_for(robot: RobotAtPort) -> list[str]:
        output = str(robot.folder / "c.calibration.yaml")
        return ["calibrate", step, "--config", FACE, *arguments, "--output", output]

    return arguments_for


def _calibrate_at_port(step: str, *arguments: str) -> Callable[[RobotAtPort], list[str]]:
    return lambda robot: [*_calibrate(step, *arguments)(robot), "--port", str(robot.port)]


def _new_face(robot: RobotAtPort) -> list[str]:
    return ["new-face", "--port", str(robot.port), "--output", str(robot.folder / "mine.yaml")]


def _stand_away(robot: RobotAtPort) -> None:
    """Move all servos but the first so far from neutral that the way back takes a second."""
    for simulated, servo in zip(robot.chain.servos[1:], robot.servos[1:], strict=True):
        simulated.stand_at(servo.pulse(30.0))


def _forget_limits(robot: RobotAtPort) -> None:
    """Set four registers of every servo so that they differ from what the face's YAML requires."""
    for servo in robot.chain.servos:
        servo["min_position_limit"], servo["max_position_limit"] = 0, servo.model.n_positions - 1
        servo["return_delay_time"], servo["operating_mode"] = 250, 3


def _without_current_limits(robot: RobotAtPort) -> None:
    """Set all servos to the operating mode that new servos have."""
    for servo in robot.chain.servos:
        servo["operating_mode"] = 3


def _measure(robot: RobotAtPort) -> list[str]:
    """Return the arguments of a `measure` that waits at its first pose: nothing writes its file."""
    markers = str(robot.folder / "markers.csv")
    return _calibrate_at_port("measure", "--tracker", markers)(robot)


def _line_file(robot: RobotAtPort) -> Path:
    return robot.folder / "line.perf"


def _perform(robot: RobotAtPort) -> list[str]:
    return _at_port("lines", "perform", str(_line_file(robot)), "--mute")(robot)


def _write_performance(robot: RobotAtPort) -> None:
    """Write a performance of a minute of noise with the mouth at rest: only start and end move."""
    sound = robot.folder / "noise.wav"
    noise = np.random.default_rng(0).normal(0.0, 0.01, _LONG_S * SAMPLE_RATE_HZ)
    soundfile.write(sound, noise, SAMPLE_RATE_HZ)
    face = load_face()
    faces = np.tile(face.rest.astype(np.float32), (round(_LONG_S * RATE_HZ) + 1, 1))
    kept = performed_sound(sound, included=True)
    write_performance(Performance(face.checksum, faces, (), kept, "heard"), _line_file(robot))


#: Longer than any case lasts.
_LONG_S: Final = 60
_LONG_TEXT: Final = "Peter Piper picked a peck of pickled peppers. " * 8

COMMANDS: Final = {
    command.name: command
    for command in (
        Command("run", _at_port("run", "--wav", str(CLIP))),
        Command("daemon", _at_port("daemon", "--wav", str(CLIP)), ends_well=True),
        Command("say", _at_port("say", "--mute", _LONG_TEXT)),
        Command("perform", _perform, _write_performance),
        Command("jog", _at_port("jog", "jaw", "10", "--hold-s", "30")),
        Command("neutral", _at_port("calibrate", "neutral"), _stand_away),
        Command("new-face", _new_face, _without_current_limits, answers="jaw\nopens\ny\n"),
        Command("calibrate-measure", _measure),
        Command("calibrate-guided", _calibrate_at_port("guided")),
        Command("setup-servos", _at_port("setup-servos"), _forget_limits, arms=False),
        Command(
            "run-sim",
            lambda _: ["run", "--sim", "pty", "--config", FACE, "--wav", str(CLIP)],
            own_servos=True,
        ),
        Command("calibrate-sim", _calibrate("measure", "--sim", "pty"), own_servos=True),
    )
}


def long_sound(robot: RobotAtPort) -> Path:
    """Return where the campaign puts a sound file that takes a while to examine."""
    return robot.folder / "long.wav"


def signal_cases() -> Iterator[SignalCase]:
    """Yield every command with every ending, once and twice, at every moment that matters."""
    arming = [each.name for each in COMMANDS.values() if each.arms and not each.own_servos]
    at_port = [*arming, "setup-servos"]
    for name, ending, twice in itertools.product(COMMANDS, SIGNALS, (False, True)):
        yield SignalCase(name, ending, twice=twice)
    for name, then in itertools.product(at_port, ("limp", "start")):
        # Servos that are not set up for a face are refused by its start, and left as they are.
        if then == "limp" or name not in ("new-face", "setup-servos"):
            yield SignalCase(name, Ending.KILL, then=then)
    for name in arming:
        yield SignalCase(name, Ending.STOP)
    # Before 0.3 s Python itself starts, which takes SIGINT for a mistake of its own.
    delays_s = itertools.cycle((0.3, 0.5, 0.9, 1.4))
    for ending, name in itertools.product(SIGNALS, COMMANDS):
        yield SignalCase(name, ending, Moment.STARTING, delay_s=next(delays_s))
        next(delays_s) if name == "neutral" else None  # every command meets every delay
    for name, ending in itertools.product(("run", "daemon"), SIGNALS):
        yield SignalCase(name, ending, Moment.OPENING_SOUND)
    for name, ending in zip(arming, itertools.cycle(SIGNALS), strict=False):
        yield SignalCase(name, ending, Moment.UNPLUGGED, twice=True)
        yield SignalCase(name, ending, Moment.DEAF)
    for name in ("run", "daemon", "calibrate-measure"):  # these wait for the port for half a minute
        yield SignalCase(name, Ending.TERM, Moment.UNPLUGGED)


#: Bars: limp so long after a signal, and after a second one.
LIMP_WITHIN_S: Final = 3.0
SECOND_WITHIN_S: Final = 0.3
#: The servos' watchdogs stop what moves within this time; then no shaft moves by more than that.
_WATCHDOG_S, _STILL_DEG = 0.5, 0.3
#: From the first signal to the second.
_AGAIN_S: Final = 0.1
#: A process that started on a busy machine works after this time at the latest.
_WORKS_S: Final = 60.0
#: After the servos are limp a process writes what it has to write, and ends.
_END_S: Final = 15.0
#: Half a minute for the port, and what an end takes.
_PORT_GONE_S: Final = 45.0
#: Everything is watched for so much longer: nobody gets torque again.
_WATCH_S: Final = 1.0


@dataclass(slots=True)
class SignalOutcome:
    """The outcome of a case. broken: each broken promise, in words.

    limp_s: seconds from the last signal until no servo has torque; None: not checked.
    moved_after_watchdog: shafts that moved on after a KILL; limp_after_kill: whether servos could
    be released then, None: no KILL. error: why the case itself did not work; empty: it did.
    """

    case: SignalCase
    broken: list[str] = field(default_factory=list)
    limp_s: float | None = None
    moved_after_watchdog: int = 0
    limp_after_kill: bool | None = None
    error: str = ""

    @property
    def kept(self) -> bool:
        """Whether the promise was kept."""
        return not (self.error or self.broken)

    def __str__(self) -> str:
        return f"{self.case}: {self.error or '; '.join(self.broken) or 'kept'}"


def play_signal(case: SignalCase) -> SignalOutcome:
    """Play one case to its end, in some five seconds; errors of the case itself are in `error`."""
    outcome = SignalOutcome(case)
    try:
        with _signals_heard(), robot_at_port() as robot:
            _play_case(case, robot, outcome)
    except (OSError, RuntimeError, subprocess.TimeoutExpired) as error:
        outcome.error = f"{type(error).__name__}: {error}"
    return outcome


@contextlib.contextmanager
def _signals_heard() -> Iterator[None]:
    """Start children with all stop signals enabled, also where our own shell ignores some."""
    ignored = [each for each in STOP_SIGNALS if signal.getsignal(each) is signal.SIG_IGN]
    for number in ignored:
        signal.signal(number, signal.SIG_DFL)
    try:
        yield
    finally:
        for number in ignored:
            signal.signal(number, signal.SIG_IGN)


def _play_case(case: SignalCase, robot: RobotAtPort, outcome: SignalOutcome) -> None:
    """Start a case's command, end it at the case's moment, and check servos, output, exit status.

    Broken promises are added to `outcome`. Raises RuntimeError where the moment does not come.
    """
    command = COMMANDS[case.command]
    command.prepare(robot)
    process = _launch(case, command, robot)
    _wait_for_moment(case, command, robot, process)
    if case.ending is Ending.KILL:
        _judge_killed(case, robot, process, outcome)
        return
    last_request_s = time.monotonic()
    if case.ending is Ending.STOP:
        with ThreadPoolExecutor(1) as pool:
            # Without `end` a daemon would wait, limp, for its start.
            asking = pool.submit(stop_and_wait, robot.controls[0], StopLevel.SOFT, _END_S, end=True)
            robot.look_until(asking.done, _END_S)
        _, report = asking.result()
        if report is None or report["unconfirmed"]:
            outcome.broken.append(f"the stop was answered by {report}")
    else:
        number = signal.Signals[f"SIG{case.ending}"]
        process.send_signal(number)
        # While the plug is out a second signal still waits to let go; a third one ends the waiting.
        n_more = 0 if not case.twice else 2 if case.moment is Moment.UNPLUGGED else 1
        for _ in range(n_more):
            robot.look(_AGAIN_S)
            last_request_s = time.monotonic()
            process.send_signal(number)
    timeout_s = _PORT_GONE_S if case.moment is Moment.UNPLUGGED and not case.twice else _END_S
    if not robot.look_until(lambda: process.poll() is not None, timeout_s):
        outcome.broken.append(f"did not end within {timeout_s:g} s")
    robot.look(_WATCH_S)
    _judge_limp(case, robot, last_request_s, outcome)
    _judge_words(case, command, robot, process, outcome)


def _launch(case: SignalCase, command: Command, robot: RobotAtPort) -> subprocess.Popen[bytes]:
    """Start a case's command at the robot's port, with its answers already on standard input.

    For the moment OPENING_SOUND its sound is a minute of noise, so that opening takes a while.
    """
    arguments = command.arguments(robot)
    if case.moment is Moment.OPENING_SOUND:
        sound = long_sound(robot)
        noise = np.random.default_rng(0).normal(0.0, 0.1, (48_000 * 60, 2))
        soundfile.write(sound, noise, 48_000, "PCM_24")
        arguments = [str(sound) if each.endswith(".flac") else each for each in arguments]
    process = robot.start(*arguments, stdin=subprocess.PIPE)
    assert process.stdin is not None
    process.stdin.write(command.answers.encode())
    process.stdin.flush()
    return process


def _wait_for_moment(
    case: SignalCase, command: Command, robot: RobotAtPort, process: subprocess.Popen[bytes]
) -> None:
    """Watch the servos until the signal of `case` is due.

    In a case UNPLUGGED the adapter is unplugged just before, in a case DEAF the first servo stops
    answering. Raises RuntimeError when the moment does not come.
    """
    if case.moment is Moment.STARTING:
        robot.look(case.delay_s)
        return
    if case.moment is Moment.OPENING_SOUND:
        sound = long_sound(robot)
        has_come = robot.look_until(lambda: _has_open(process.pid, sound), _WORKS_S)
    else:
        has_come = robot.look_until(
            lambda: _is_working(command, robot) or process.poll() is not None, _WORKS_S
        )
    if not has_come or process.poll() is not None:
        raise RuntimeError(f"the moment did not come: {robot.last_output}")
    if case.moment is Moment.OPENING_SOUND:
        return
    if not command.arms:
        return
    robot.look(0.7 if command.own_servos or command.name in ("run", "daemon") else 0.1)
    if case.moment is Moment.UNPLUGGED:
        robot.device.unplug()
        robot.look(0.3)
    elif case.moment is Moment.DEAF:
        robot.chain.servos[0].ignore_until(float("inf"))
        robot.look(0.1)


def _is_working(command: Command, robot: RobotAtPort) -> bool:
    """Return whether a command has come so far that its servos hold, or are being set up."""
    if command.own_servos:
        return bool(robot.controls)
    if not command.arms:
        return bool(robot.chain.servos[0]["return_delay_time"] == 0)
    torque = robot.torque
    return bool(torque.any() if command.name == "new-face" else torque.all())


def _has_open(pid: int, path: Path) -> bool:
    """Return whether a process has a file open."""
    with contextlib.suppress(OSError):
        folder = f"/proc/{pid}/fd"
        return str(path) in {os.readlink(f"{folder}/{each}") for each in os.listdir(folder)}
    return False


def _judge_limp(
    case: SignalCase, robot: RobotAtPort, ended_s: float, outcome: SignalOutcome
) -> None:
    """Add to `outcome` how long servos had torque after the end, and each promise that broke.

    ended_s: monotonic time of the last signal or stop.
    """
    outcome.limp_s = robot.stiff_until_s(ended_s)
    if case.moment is Moment.UNPLUGGED:
        return  # nobody can reach them
    deaf_servos = [0] if case.moment is Moment.DEAF else []
    holding = [n for n in np.flatnonzero(robot.torque).tolist() if n not in deaf_servos]
    if holding:
        outcome.broken.append(f"servos {holding} hold after the end")
    if case.moment is Moment.DEAF:
        outcome.limp_s = None
        return
    if case.moment is Moment.STARTING and robot.switched_on(ended_s + SECOND_WITHIN_S):
        outcome.broken.append("torque came on after the signal")
    limit_s = SECOND_WITHIN_S if case.twice else LIMP_WITHIN_S
    if outcome.limp_s > limit_s:
        outcome.broken.append(f"limp only {outcome.limp_s:.2f} s after the signal")


def _judge_words(
    case: SignalCase,
    command: Command,
    robot: RobotAtPort,
    process: subprocess.Popen[bytes],
    outcome: SignalOutcome,
) -> None:
    """Check a command's exit status, and whether its output says how many confirmed the stop."""
    output, status = robot.output, process.poll()
    if "Traceback" in output or "Fatal Python error" in output:
        outcome.broken.append(f"traceback: {robot.last_output}")
    allowed = _allowed_statuses(case, command)
    if status is not None and status not in allowed:
        outcome.broken.append(f"exit status {status}, not {allowed}: {robot.last_output[-300:]}")
    if not command.arms or case.moment in (Moment.STARTING, Moment.OPENING_SOUND):
        return
    if case.moment in (Moment.UNPLUGGED, Moment.DEAF):
        expected = "NOT by"
    elif command.name == "daemon":
        expected = "confirmed by all 4 servos"
    else:
        expected = "confirmed by 1 servo" if command.name == "new-face" else "confirmed by 4 servos"
    if expected not in output:
        outcome.broken.append(f"does not say {expected!r}: {robot.last_output[-300:]}")


def _allowed_statuses(case: SignalCase, command: Command) -> tuple[int, ...]:
    """Return the exit statuses that are right for a case; -N: ended by signal N."""
    if case.ending is Ending.STOP:
        # What was being measured, set up or held still is not done; speech has no more to do.
        is_speaking = command.name in ("run", "daemon", "say", "perform", "run-sim")
        return (0,) if is_speaking else (0, ExitStatus.STOPPED_EARLY)
    number = signal.Signals[f"SIG{case.ending}"].value
    if case.moment in (Moment.UNPLUGGED, Moment.DEAF):
        # Some have told that no servo can be reached, and ended, before the last signal comes.
        return (ExitStatus.UNCONFIRMED, *((-number,) if case.twice else ()))
    # Before a program has asked for its signals they end it as the system does.
    # So they do after its servos are limp: shells show both as the same.
    is_early = case.moment in (Moment.STARTING, Moment.OPENING_SOUND)
    ended_by_system = (-number,) if is_early or case.twice else ()
    # `neutral` takes a second: it may just have come to its own end.
    ended_well = (0,) if command.ends_well or command.name == "neutral" else ()
    ended_by_signal = () if command.ends_well and not is_early else (128 + number,)
    return (*ended_well, *ended_by_signal, *ended_by_system)


def _judge_killed(
    case: SignalCase,
    robot: RobotAtPort,
    process: subprocess.Popen[bytes],
    outcome: SignalOutcome,
) -> None:
    """Kill all processes; check that servos stop by themselves and a command can release them."""
    kill_all(process)
    robot.look(_WATCHDOG_S)
    watched_s = time.monotonic()
    robot.look(2.0)
    outcome.moved_after_watchdog = int((robot.moved_deg(watched_s) > _STILL_DEG).sum())
    if outcome.moved_after_watchdog:
        outcome.broken.append(f"{outcome.moved_after_watchdog} shafts moved on")
    if case.then == "limp":
        release = robot.start("limp", "--port", str(robot.port))
    else:
        release = robot.start("calibrate", "neutral", "--config", FACE, "--port", str(robot.port))
    robot.look_until(lambda: release.poll() is not None, _WORKS_S)
    if release.poll() != 0:
        outcome.broken.append(
            f"`{case.then}` ended with {release.poll()}: {robot.last_output[-300:]}"
        )
    outcome.limp_after_kill = not robot.torque.any()
    if not outcome.limp_after_kill:
        outcome.broken.append(f"{robot.torque.sum()} servos hold after `{case.then}`")


def signal_figures(outcomes: Sequence[SignalOutcome]) -> dict[str, float | int]:
    """Return the figures of the campaign.

    rest_after_worst_s, second_after_worst_s: longest time until limp after one signal, and after a
    second one, for commands that were working. kill_moved_after_watchdog: shafts that moved on.
    """
    killed = [o for o in outcomes if o.limp_after_kill is not None]
    working = [o for o in outcomes if o.case.moment is Moment.WORKING and o.case.ending in SIGNALS]
    once_s = [o.limp_s or 0.0 for o in working if not o.case.twice]
    twice_s = [o.limp_s or 0.0 for o in working if o.case.twice]
    return {
        "cases": len(outcomes),
        "kept": sum(o.kept for o in outcomes),
        "rest_after_worst_s": max(once_s, default=0.0),
        "second_after_worst_s": max(twice_s, default=0.0),
        "killed": len(killed),
        "kill_moved_after_watchdog": sum(o.moved_after_watchdog for o in killed),
        "limp_after_kill": sum(bool(o.limp_after_kill) for o in killed),
        "errors": sum(bool(o.error) for o in outcomes),
    }
