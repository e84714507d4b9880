"""Every command that can move servos, and every way to end it: what the signal campaign plays."""

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Final

import numpy as np
import soundfile

from lipservo_lab.bench.stops.robot_at_port import CLIP, FACE, RobotAtPort
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.face.model import load_face
from lipsync.offline.performance import RATE_HZ, Performance, performed_sound
from lipsync.offline.performance_file import write_performance


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
    """A command at simulated servos.

    arguments: of a robot. prepare: what its servos are like before. answers: on standard input.
    own_servos: it simulates servos of its own, so that only what it says can be judged.
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
    """One command ended in one way. twice: the signal comes again 0.1 s later.

    then: what lets the servos go after a KILL, "limp" or "start". delay_s: from the moment on.
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
    def made(robot: RobotAtPort) -> list[str]:
        output = str(robot.folder / "c.calibration.yaml")
        return ["calibrate", step, "--config", FACE, *arguments, "--output", output]

    return made


def _calibrate_at_port(step: str, *arguments: str) -> Callable[[RobotAtPort], list[str]]:
    return lambda robot: [*_calibrate(step, *arguments)(robot), "--port", str(robot.port)]


def _new_face(robot: RobotAtPort) -> list[str]:
    return ["new-face", "--port", str(robot.port), "--output", str(robot.folder / "mine.yaml")]


def _stand_away(robot: RobotAtPort) -> None:
    """So far from neutral that the way there takes a second."""
    for simulated, servo in zip(robot.chain.servos[1:], robot.servos[1:], strict=True):
        simulated.stand_at(servo.pulse(30.0))


def _forget_limits(robot: RobotAtPort) -> None:
    """Four registers of every servo differ from what the face asks for."""
    for servo in robot.chain.servos:
        servo["min_position_limit"], servo["max_position_limit"] = 0, 4095
        servo["return_delay_time"], servo["operating_mode"] = 250, 3


def _without_current_limits(robot: RobotAtPort) -> None:
    """As from the factory, which is what new servos are like."""
    for servo in robot.chain.servos:
        servo["operating_mode"] = 3


def _performance(robot: RobotAtPort) -> Path:
    return robot.folder / "line.perf"


def _perform(robot: RobotAtPort) -> list[str]:
    return _at_port("lines", "perform", str(_performance(robot)), "--mute")(robot)


def _write_performance(robot: RobotAtPort) -> None:
    """A minute of noise with a mouth at rest: who moves is the life cycle."""
    sound = robot.folder / "noise.wav"
    noise = np.random.default_rng(0).normal(0.0, 0.01, _LONG_S * SAMPLE_RATE_HZ)
    soundfile.write(sound, noise, SAMPLE_RATE_HZ)
    face = load_face()
    faces = np.tile(face.rest.astype(np.float32), (round(_LONG_S * RATE_HZ) + 1, 1))
    kept = performed_sound(sound, included=True)
    write_performance(Performance(face.checksum, faces, (), kept, "heard"), _performance(robot))


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
        Command("calibrate-typed", _calibrate_at_port("measure", "--tracker", "typed")),
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
    """Where the campaign puts a sound file that takes a while to examine."""
    return robot.folder / "long.wav"


def signal_cases() -> Iterator[SignalCase]:
    """Every command x every ending, once and twice, at every moment that makes a difference."""
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
    for name in ("run", "daemon", "calibrate-typed"):  # these wait for the port for half a minute
        yield SignalCase(name, Ending.TERM, Moment.UNPLUGGED)
