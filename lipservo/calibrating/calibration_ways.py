"""The ways of `lipservo calibrate`: from whom poses and markers come, and what is made of them."""

import datetime
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from calibration.calibration import Calibration, CalibrationError, Following, ServoMemory
from calibration.capture.capture import Capture, Measure, Move
from calibration.capture.trackers import FileTracker, SeenByComputation, Tracker, TypedTracker
from calibration.fit.correspondence import LIPS_NEEDED
from calibration.fit.jaw_fit import fit_jaw, jaw_agreement, jaw_markers
from calibration.fit.learnt_face import fit_calibration
from calibration.fit.measured import MeasuredFit, fit_measured
from calibration.fit.procedure import Procedure
from calibration.fit.servo_response import identify
from calibration.joint_range import JointRange
from calibration.simulated.face import marker_positions_mm, simulated_face
from calibration.simulated.robot import SENSOR_NOISE_MM, SimulatedRobot, draw_robot
from calibration.simulated.servos import SimulatedServos
from firmware_bridge.clock import MonotonicClock
from lipservo.calibrating.guided_calibration import calibrate_by_eye
from lipservo.face.held_face import SPEED_DEG_S, HeldFace
from lipservo.face.servos import bus_for, mouth_rules, servo_memories, simulated_wire
from lipservo.settings.settings import FaceSettings
from lipservo.terminal.keys import read_key, read_line
from lipservo.terminal.output import MESSAGES
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.markers import MARKERS_47

Array = NDArray[np.float64]

#: What a person who types is asked for: the least that says how open and how wide a mouth is, and
#: the chin.
TYPED_MARKERS = ("inner_lip_13", "inner_lip_14", "outer_lip_61", "outer_lip_291", "outer_lip_17")
TYPED = "typed"


@dataclass(frozen=True, slots=True)
class Workplace:
    """What every way needs. quiet: no progress bar; lags: chirps and steps, where servos move."""

    settings: FaceSettings
    model: FaceWithAnimPhos
    n_poses: int
    keep: Path | None = None
    quiet: bool = False
    lags: bool = True
    speed_deg_s: float = SPEED_DEG_S

    @property
    def joints(self) -> list[JointRange]:
        """Of the mouth."""
        mouth = self.settings.mouth_servos
        return [JointRange(n, s.min_deg, s.max_deg) for n, s in mouth.items()]

    def procedure(self, seed: int = 0) -> Procedure:
        """What is captured of this face."""
        rules = mouth_rules(self.settings)
        return Procedure(self.model, self.joints, self.n_poses, rules, seed)


@dataclass(frozen=True, slots=True)
class Result:
    """What a way leads to. fit: None where nothing was measured, or a jaw alone."""

    calibration: Calibration
    fit: MeasuredFit | None = None
    warnings: tuple[str, ...] = ()

    @property
    def backlash_deg(self) -> Array:
        """(n_servos,), 0 where nothing is known."""
        following = self.calibration.following
        n_servos = len(self.calibration.servo_names)
        return np.zeros(n_servos) if following is None else following.backlash_deg

    def with_following(self, following: Following) -> "Result":
        """The same, with lags."""
        return replace(self, calibration=replace(self.calibration, following=following))


def fit_capture(at: Workplace, capture: Capture) -> Result:
    """A capture of this face, from wherever, to its calibration.

    One servo and no lips among the markers: the jaw alone.
    """
    mouth = at.settings.mouth_servos.values()
    date = datetime.date.today().isoformat()
    models = tuple(servo.model for servo in mouth)
    positive = [servo.positive for servo in mouth]
    checksum, lips = at.settings.checksum, LIPS_NEEDED & set(capture.marker_names)
    if len(at.joints) == 1 and jaw_markers(capture.marker_names) and not lips:
        (joint,) = at.joints
        jaw, warnings = fit_jaw(
            at.model, capture, joint, checksum, date=date, servo_models=models, positive=positive
        )
        return Result(jaw, None, warnings)
    fit = fit_measured(
        at.model,
        capture,
        at.joints,
        checksum,
        date=date,
        servo_models=models,
        positive=positive,
        rules=mouth_rules(at.settings),
    )
    return Result(fit.calibration, fit, fit.warnings)


def by_simulated_face(at: Workplace) -> Result:
    """No measuring: the simulated face, and the lags of servos simulated to the byte.

    A face with a port gets no lags here: its own servos are there to be asked.
    """
    rules = mouth_rules(at.settings)
    fitted = Result(fit_calibration(at.model, at.joints, at.settings.checksum, rules=rules))
    if not at.lags or at.settings.bus.kind != "simulated":
        return fitted
    bus, clock = simulated_wire(at.settings)
    with bus, HeldFace(at.settings, bus, clock) as face:
        return _with_lags(at, face, fitted)


def by_practice(at: Workplace, seed: int) -> Result:
    """A simulated robot drawn from a seed, in memory and at once."""
    robot = _drawn_robot(at, seed)
    capture = _capture(at, MARKERS_47.names, robot.move, robot.measure, seed=seed)
    result = fit_capture(at, capture)
    if not at.lags:
        return result
    servos = SimulatedServos.drawn(len(at.joints), seed)
    return result.with_following(identify(servos.encoders_deg, at.joints, result.backlash_deg))


def by_servos(
    at: Workplace,
    make_tracker: Callable[[HeldFace], Tracker],
    passed: Callable[[Array], object] = lambda _: None,
    seed: int = 0,
) -> Result:
    """The face's own servos, whatever sees the markers: capture, fit, then the servos' lags.

    passed: hears of every place that the encoders came to, measured or not.
    """
    memories = servo_memories(at.settings)
    with _held(at) as face:
        tracker = make_tracker(face)

        def move(goal_deg: Array) -> Array:
            reached_deg = face.move(goal_deg)
            passed(reached_deg)
            return reached_deg

        try:
            capture = _capture(
                at, tracker.marker_names, move, tracker.measure, tracker.arrived, seed=seed
            )
        finally:
            if isinstance(tracker, FileTracker):
                tracker.close()
        result = with_memories(fit_capture(at, capture), memories)
        return _with_lags(at, face, result) if at.lags else result


def by_eye(at: Workplace) -> Result:
    """Poses made with keys, on the face's own servos or on simulated ones."""
    model = at.model
    names = [joint.name for joint in at.joints]
    face = simulated_face(model.markers_mm(model.rest[None])[0], names)

    def drawn(positions_deg: Array) -> Array:
        return np.asarray(marker_positions_mm(face, positions_deg[None])[0])

    guide = partial(calibrate_by_eye, at.settings, model, console=MESSAGES, keep=at.keep)
    if at.settings.bus.kind == "simulated":
        by_keys = guide(move=lambda goal_deg: goal_deg, read_key=read_key, drawn=drawn)
        return Result(by_keys)
    memories = servo_memories(at.settings)
    with _held(at) as robot:
        fitted = guide(move=robot.lead, read_key=lambda: robot.hold_while(read_key), drawn=None)
        result = with_memories(Result(fitted), memories)
        return _with_lags(at, robot, result) if at.lags else result


def by_simulated_skin(at: Workplace, seed: int | None) -> Result:
    """The servos over the wire, behind a computed face: as designed, or drawn from a seed."""
    if seed is not None:
        robot = _drawn_robot(at, seed)
        drawn = SeenByComputation(MARKERS_47.names, lambda _: robot.measure())
        return by_servos(at, lambda _: drawn, robot.move, seed)
    names = [joint.name for joint in at.joints]
    face = simulated_face(at.model.markers_mm(at.model.rest[None])[0], names)
    noise = np.random.default_rng(0)

    def look(reached_deg: Array) -> Array:
        exact_mm = marker_positions_mm(face, reached_deg[None])[0]
        return np.asarray(exact_mm + noise.normal(0.0, SENSOR_NOISE_MM, exact_mm.shape))

    return by_servos(at, lambda _: SeenByComputation(MARKERS_47.names, look))


def tracker_of(at: Workplace, source: str, axes: str) -> Callable[[HeldFace], Tracker]:
    """`typed`, or the path of a file or folder that another program fills."""
    if source == TYPED:
        return lambda face: TypedTracker(
            TYPED_MARKERS, lambda question: face.hold_while(lambda: read_line(question))
        )
    path = Path(source)
    if not path.is_dir() and path.suffix.lower() not in (".csv", ".json"):
        raise CalibrationError(
            f"--tracker {source}: expected `typed`, a .csv or .json file, or a folder"
        )
    names = tuple(joint.name for joint in at.joints)
    return lambda face: FileTracker(path, names, face.hold, _say, axes=axes)


def jaw_check(at: Workplace, calibration: Calibration) -> float | None:
    """How well the joint that opens goes with the talker's jaw; None without such a joint."""
    words = [servo.positive for servo in at.settings.mouth_servos.values()]
    return jaw_agreement(at.model, calibration, words.index("opens")) if "opens" in words else None


def with_memories(result: Result, memories: Sequence[ServoMemory | None]) -> Result:
    """With what the servos hold, where all of them said so."""
    known = tuple(memory for memory in memories if memory is not None)
    if len(known) != len(result.calibration.servo_names):
        return result
    origin = replace(result.calibration.origin, servo_memories=known)
    return replace(result, calibration=replace(result.calibration, origin=origin))


@contextmanager
def _held(at: Workplace) -> Iterator[HeldFace]:
    clock = MonotonicClock()
    with ExitStack() as stack:
        bus = stack.enter_context(bus_for(at.settings, clock))
        yield stack.enter_context(HeldFace(at.settings, bus, clock, speed_deg_s=at.speed_deg_s))


def _with_lags(at: Workplace, face: HeldFace, result: Result) -> Result:
    with _bar(at, "chirps", len(at.joints)) as done:
        return result.with_following(
            identify(
                face.drive, at.joints, result.backlash_deg, rate_hz=face.rate_hz, progress=done
            )
        )


def _capture(
    at: Workplace,
    marker_names: tuple[str, ...],
    move: Move,
    measure: Measure,
    arrived: Callable[[int, Array], None] = lambda *_: None,
    *,
    seed: int,
) -> Capture:
    with _bar(at, "poses", at.n_poses) as done:
        return at.procedure(seed).capture(
            marker_names, move, measure, keep=at.keep, arrived=arrived, progress=done
        )


def _drawn_robot(at: Workplace, seed: int) -> SimulatedRobot:
    rest_mm = at.model.markers_mm(at.model.rest[None])[0]
    names = [joint.name for joint in at.joints]
    return SimulatedRobot(draw_robot(rest_mm, names, seed), noise_seed=seed)


@contextmanager
def _bar(at: Workplace, what: str, total: int) -> Iterator[Callable[[int], None]]:
    """A progress bar with the time left; how to tell it what is done."""
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=MESSAGES,
        transient=True,
        disable=at.quiet,
    ) as bar:
        task = bar.add_task(what, total=total)
        yield lambda done: bar.update(task, completed=done)


def _say(line: str) -> None:
    MESSAGES.print(line, soft_wrap=True, highlight=False)
