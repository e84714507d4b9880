"""Calibrations that are measured: on the face's own servos, from files, or on a simulated robot.

Each ends with the servos' lags (delays behind their goals), which `lipservo calibrate lags`
measures alone.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from calibration.calibration import (
    Calibration,
    CalibrationError,
    Following,
    ServoMemory,
    check_calibration,
    check_servo_memories,
)
from calibration.capture.capture import Capture, Robot
from calibration.capture.sanity import is_flat
from calibration.capture.trackers import FileTracker, SeenByComputation, Tracker
from calibration.fit.jaw import fit_jaw, jaw_agreement, jaw_markers
from calibration.fit.learnt_face import fit_calibration
from calibration.fit.measured import MeasuredFit, backlash_only, fit_measured
from calibration.fit.procedure import take_grade
from calibration.fit.retargeting import LIPS_NEEDED
from calibration.fit.servo_response import identify
from calibration.simulated.practice_robot import (
    family_of,
    guessed_joints,
    markers_of_face,
    practice_robot,
)
from calibration.simulated.robot import SENSOR_NOISE_MM, SimulatedRobot
from calibration.simulated.robot_family import RobotFamily
from calibration.simulated.servos import SimulatedServos
from lipservo.calibrating.calibration_setup import (
    CalibrationSetup,
    held_servos,
    progress_bar,
    today,
)
from lipservo.runtime.servos.assembly import servo_memories, simulated_wire
from lipservo.runtime.servos.held_face import HeldFace, Here
from lipservo.terminal.output import MESSAGES
from lipsync.arrays import Array
from lipsync.markers import MARKERS_47

#: What one camera from the front does not see.
PROTRUSION = "protrusion"


@dataclass(frozen=True, slots=True)
class CalibrationResult:
    """A new calibration, with warnings for a person.

    fit: the fit of measured lip markers; None if no lip markers were measured.
    """

    calibration: Calibration
    fit: MeasuredFit | None = None
    warnings: tuple[str, ...] = ()

    def graded_by(
        self, setup: CalibrationSetup, robot: Robot, n_captured: int = 0
    ) -> "CalibrationResult":
        """Return the result with a grade, measured on the robot in ten poses of speech.

        Unchanged if `fit` is None. setup: the face's servos, and `keep`, the file of captured
        poses: poses to grade by follow in it after `n_captured` others.
        """
        if self.fit is None:
            return self
        names = self.fit.face.marker_names
        fit = take_grade(self.fit, setup.servos, names, robot, setup.kept, n_captured)
        graded = fit.calibration
        calibration = replace(self.calibration, grade=graded.grade, coverage=graded.coverage)
        return CalibrationResult(calibration, fit, fit.warnings)

    def seen_by(self, setup: CalibrationSetup) -> "CalibrationResult":
        """Return the result, marked as of unmeasured protrusion if the markers have no depth."""
        if setup.sees_forward:
            return self
        origin = replace(self.calibration.origin, not_measured=PROTRUSION)
        return replace(self, calibration=replace(self.calibration, origin=origin))

    def with_following(self, following: Following) -> "CalibrationResult":
        """Return the result with the servos' measured lags, backlash, speeds and bandwidths."""
        return replace(self, calibration=replace(self.calibration, following=following))

    def with_memories(self, memories: Sequence[ServoMemory | None]) -> "CalibrationResult":
        """Return the result with the servos' registers; unchanged if `memories` lacks any servo."""
        known = tuple(memory for memory in memories if memory is not None)
        if len(known) != len(self.calibration.servo_names):
            return self
        origin = replace(self.calibration.origin, servo_memories=known)
        return replace(self, calibration=replace(self.calibration, origin=origin))


def _known_following(calibration: Calibration) -> Following:
    """Return how servos follow their goals, as far as it is known.

    If nothing is, lags and backlash are 0, and speeds and bandwidths infinite.
    """
    return calibration.following or backlash_only(np.zeros(len(calibration.servo_names)))


def fit_capture(setup: CalibrationSetup, capture: Capture) -> CalibrationResult:
    """Fit a calibration to a capture of this face.

    With one servo and no lip markers, only the jaw is fitted. Raises CalibrationError, as for
    markers without any depth unless `setup.accept` is set.
    """
    if setup.sees_forward and is_flat(capture):
        if not setup.accept:
            raise CalibrationError(
                "the markers' depth (z) does not change, so how far the lips go forward is "
                "unknown; measure z too, or accept a calibration from the front alone with "
                "--accept"
            )
        setup = replace(setup, sees_forward=False)
    servos = setup.servos
    lips = LIPS_NEEDED & set(capture.marker_names)
    if len(servos.joints) == 1 and jaw_markers(capture.marker_names) and not lips:
        jaw, warnings = fit_jaw(setup.model, capture, servos, date=today(), accept=setup.accept)
        return CalibrationResult(jaw, None, warnings).seen_by(setup)
    fit = fit_measured(setup.model, capture, servos, date=today(), accept=setup.accept)
    return CalibrationResult(fit.calibration, fit, fit.warnings).seen_by(setup)


def jaw_check(setup: CalibrationSetup, calibration: Calibration) -> float | None:
    """Return the correlation, -1 to 1, of the joint that opens the mouth with the speaker's jaw.

    None: no joint opens the mouth in the positive direction.
    """
    positive = setup.servos.positive
    if "opens" not in positive:
        return None
    return jaw_agreement(setup.model, calibration, positive.index("opens"))


def with_lags(
    setup: CalibrationSetup, face: HeldFace, result: CalibrationResult
) -> CalibrationResult:
    """Measure the lags of the servos that `face` holds; return the result with them."""
    return result.with_following(_measure_following(setup, face, result.calibration))


def measure_lags(setup: CalibrationSetup, calibration: Calibration) -> Calibration:
    """Return the calibration with newly measured lags, speeds and bandwidths of this face's servos.

    Backlash stays as it was, since it comes from the markers. Raises CalibrationError for a
    calibration of another face or model, or of servos that were set up anew since.
    """
    check_calibration(calibration, setup.model, setup.servos.names, setup.settings.checksum)
    if setup.settings.capabilities.in_memory and not setup.settings.buses:
        held = _on_simulated_wire(setup)
    else:
        check_servo_memories(calibration, servo_memories(setup.settings))
        held = held_servos(setup)
    with held as face:
        return replace(calibration, following=_measure_following(setup, face, calibration))


def _on_simulated_wire(setup: CalibrationSetup) -> HeldFace:
    bus, clock = simulated_wire(setup.settings)
    return HeldFace(setup.settings, clock, bus=bus)


#: No hobby servo is later; a second would be a typing error.
_MOST_LAG_MS = 500.0


def typed_lags(
    setup: CalibrationSetup, calibration: Calibration, typed: Sequence[str]
) -> Calibration:
    """Return the calibration with lags typed by a person, as `jaw=60` in ms; other lags stay.

    Raises CalibrationError for an unknown or repeated joint, and for no number within 0 to 500 ms.
    """
    names = list(setup.servos.names)
    check_calibration(calibration, setup.model, setup.servos.names, setup.settings.checksum)
    following = _known_following(calibration)
    lag_s, names_seen = following.lag_s.copy(), set()
    for text in typed:
        name, _, number = text.partition("=")
        if name not in names:
            known = ", ".join(names)
            raise CalibrationError(f"--lag-ms {text}: no such joint; use one of {known}")
        if name in names_seen:
            raise CalibrationError(f"--lag-ms {text}: {name} is given twice; give it once")
        names_seen.add(name)
        try:
            lag_ms = float(number)
        except ValueError:
            lag_ms = math.nan
        if not 0.0 <= lag_ms <= _MOST_LAG_MS:
            allowed = f"JOINT=MS with 0 to {_MOST_LAG_MS:g} ms, such as {name}=60"
            raise CalibrationError(f"--lag-ms {text}: needs {allowed}")
        lag_s[names.index(name)] = lag_ms / 1e3
    return replace(calibration, following=replace(following, lag_s=lag_s))


def _measure_following(
    setup: CalibrationSetup, face: HeldFace, calibration: Calibration
) -> Following:
    """Return how the servos follow their goals: lags, top speeds and bandwidths, measured now.

    Backlash stays, and all figures of servos without an encoder; a printed line names these servos,
    and the command to type their lags.
    """
    joints = setup.servos.joints
    with_encoder = np.flatnonzero(face.has_place)
    if len(with_encoder) < len(joints):
        blind = [joint.name for joint, has in zip(joints, face.has_place, strict=True) if not has]
        say(
            f"how late {', '.join(blind)} follow cannot be measured, for want of encoders; film "
            f"one and type it: `lipservo calibrate lags FILE --lag-ms {blind[0]}=60`"
        )
    before = _known_following(calibration)
    if not len(with_encoder):
        return before

    def drive(goals_deg: Array, rate_hz: float) -> Array:
        all_goals_deg = np.zeros((len(goals_deg), len(joints)))
        all_goals_deg[:, with_encoder] = goals_deg
        return face.drive(all_goals_deg, rate_hz)[:, with_encoder]

    driven = [joints[index] for index in with_encoder]
    with progress_bar(setup, "chirps", len(driven)) as done:
        found = identify(
            drive, driven, before.backlash_deg[with_encoder], rate_hz=face.rate_hz, progress=done
        )
    # Measured figures replace those of the servos with encoders.
    figures = {}
    for field in ("lag_s", "top_speed_deg_s", "bandwidth_hz"):
        figures[field] = getattr(before, field).copy()
        figures[field][with_encoder] = getattr(found, field)
    return replace(before, **figures)


#: Called with a calibration that is usable though not yet whole.
Save = Callable[[CalibrationResult], object]
#: Captures the markers of these names on a robot.
Take = Callable[[CalibrationSetup, tuple[str, ...], Robot], Capture]
#: Share of its current cap from which a servo counts as pressing: what it measures is noisy.
_STRAINED_SHARE = 0.9


def calibrate_on_servos(
    setup: CalibrationSetup,
    make_tracker: Callable[[HeldFace], Tracker],
    passed: Callable[[Array], object] = lambda _: None,
    seed: int = 0,
    save: Save = lambda _: None,
    take: Take | None = None,
) -> CalibrationResult:
    """Capture poses on the face's servos, fit and grade a calibration, then measure the lags.

    Interrupted at any moment, it goes on where it was when it is called again, by the poses in
    `setup.keep`.

    Parameters
    ----------
    setup : CalibrationSetup
        Face and options.
    make_tracker : Callable[[HeldFace], Tracker]
        Makes the source of markers.
    passed : Callable[[Array], object]
        Called with the encoders' positions after every move, (n_servos,) degrees.
    seed : int
        Seed of the plan of poses.
    save : Save
        Called with the calibration after the fit, and again with its grade.
    take : Take | None
        Captures the poses; None: those of `capture_face`. Without it nothing is graded.

    Returns
    -------
    CalibrationResult
        The calibration and its errors in mm.
    """
    memories = servo_memories(setup.settings)
    with held_servos(setup) as face:
        tracker = make_tracker(face)

        def capture_and_fit(here: Here) -> CalibrationResult:
            """Capture, fit and grade in a thread, so that a stop does not wait for a fit.

            here: runs a call in the thread that moves the servos, and returns its result.
            """

            def move(goal_deg: Array) -> Array:
                reached_deg: Array = here(lambda: face.move(goal_deg))
                passed(reached_deg)
                setup.watch.arrived(reached_deg)
                return reached_deg

            def measure() -> Array:
                seen_mm: Array = here(tracker.measure)
                here(face.check_sent_whole)
                setup.watch.seen(tracker.marker_names, seen_mm)
                return seen_mm

            def arrived(pose: int, reached_deg: Array) -> None:
                here(lambda: tracker.arrived(pose, reached_deg))

            def strained() -> str | None:
                return strained_servo(setup, here(lambda: face.effort))

            robot = Robot(move, measure, arrived, strained=strained)
            capture = (take or partial(capture_face, seed=seed))(setup, tracker.marker_names, robot)
            result = fit_capture(setup, capture).with_memories(memories)
            save(result)
            if take is not None:
                return result
            result = result.graded_by(setup, Robot(move, measure, arrived), capture.n_planned)
            save(result)
            return result

        try:
            result = face.work(capture_and_fit)
        finally:
            if isinstance(tracker, FileTracker):
                tracker.close()
        return with_lags(setup, face, result) if setup.lags else result


def computed_tracker(setup: CalibrationSetup) -> Tracker:
    """Return a tracker of the simulated face, whose markers are computed from servos' positions."""
    markers_of = markers_of_face(setup.model.markers_mm(setup.model.rest[None])[0], setup.servos)
    noise = np.random.default_rng(0)

    def look(reached_deg: Array) -> Array:
        exact_mm = markers_of(reached_deg[None])[0]
        return np.asarray(exact_mm + noise.normal(0.0, SENSOR_NOISE_MM, exact_mm.shape))

    return SeenByComputation(MARKERS_47.names, look)


def capture_face(
    setup: CalibrationSetup, marker_names: tuple[str, ...], robot: Robot, *, seed: int
) -> Capture:
    """Capture the markers `marker_names` in all poses of the robot; show progress.

    seed: of the plan of poses.
    """
    n_wanted, setup = setup.n_poses, setup.for_machine()
    n_joints = len(setup.servos.joints)
    more = "" if setup.n_poses == n_wanted else f": {n_joints} joints need more than {n_wanted}"
    minutes = (setup.pose_s * setup.estimated_poses + setup.chirps_s) / 60.0
    say(
        f"about {setup.estimated_poses} poses{more}; {minutes:.0f} minutes and what the tracker "
        "needs"
    )
    with progress_bar(setup, "poses", setup.n_poses) as done:
        robot = replace(robot, progress=done)
        return setup.procedure(seed).capture(marker_names, robot, kept=setup.kept, report=say)


def strained_servo(setup: CalibrationSetup, effort: Array) -> str | None:
    """Return the first servo that draws 90 % of its `max_current_ma` or more, and print a line.

    Parameters
    ----------
    setup : CalibrationSetup
        Setup with the face's servos.
    effort : Array
        (n_servos,) of the mouth, in stall torques.

    Returns
    -------
    str | None
        The name; None if no servo draws so much, or none measures it.
    """
    for (name, servo), share in zip(setup.settings.mouth_servos.items(), effort, strict=True):
        if servo.strain(share) >= _STRAINED_SHARE:
            say(f"{name} draws its max_current_ma: lips are closed no farther than this")
            return name
    return None


def say(line: str) -> None:
    """Print a line on stderr."""
    MESSAGES.print(line)


def fit_simulated_face(setup: CalibrationSetup) -> CalibrationResult:
    """Calibrate the simulated face without a capture; lags are measured on simulated servos.

    A face with a port gets no lags here: `lipservo calibrate lags` measures its own servos. Raises
    CalibrationError for servos that the simulated face does not have.
    """
    servos = setup.servos
    if family_of(servos) is RobotFamily.ELASTIC:
        raise CalibrationError(
            f"the simulated face has no such servos as {', '.join(servos.names)}; `lipservo "
            "calibrate practise SEED` calibrates a simulated robot with joints of any names"
        )
    fitted = CalibrationResult(
        fit_calibration(setup.model, servos.joints, servos.face_checksum, rules=servos.rules)
    )
    can = setup.settings.capabilities
    if not (setup.lags and can.in_memory and can.place):
        return fitted
    with _on_simulated_wire(setup) as face:
        return with_lags(setup, face, fitted)


def practise_in_memory(
    setup: CalibrationSetup,
    seed: int,
    family: RobotFamily | None = None,
    save: Save = lambda _: None,
) -> CalibrationResult:
    """Calibrate a simulated robot drawn by `seed`, without servos or a port.

    family: as for `practice_robot`; save: as for `calibrate_on_servos`.
    """
    robot = _drawn_robot(setup, seed, family)
    robot_functions = Robot(robot.move, robot.measure)
    capture = capture_face(setup, MARKERS_47.names, robot_functions, seed=seed)
    result = fit_capture(setup, capture)
    save(result)
    result = result.graded_by(setup, robot_functions, capture.n_planned)
    if not setup.lags:
        return result
    joints = setup.servos.joints
    servos = SimulatedServos.drawn(len(joints), seed)
    backlash_deg = _known_following(result.calibration).backlash_deg
    return result.with_following(identify(servos.encoders_deg, joints, backlash_deg))


def practise_over_wire(
    setup: CalibrationSetup,
    seed: int,
    family: RobotFamily | None = None,
    save: Save = lambda _: None,
) -> CalibrationResult:
    """Calibrate the face's servos with markers of a simulated robot's skin, drawn by `seed`.

    family: as for `practice_robot`; save: as for `calibrate_on_servos`.
    """
    robot = _drawn_robot(setup, seed, family)
    tracker = SeenByComputation(MARKERS_47.names, lambda _: robot.measure())
    return calibrate_on_servos(setup, lambda _: tracker, robot.move, seed, save)


def _drawn_robot(setup: CalibrationSetup, seed: int, family: RobotFamily | None) -> SimulatedRobot:
    """Return the simulated robot drawn by `seed`; print the joints whose motion had to be guessed.

    family: as for `practice_robot`.
    """
    rest_mm = setup.model.markers_mm(setup.model.rest[None])[0]
    robot = practice_robot(rest_mm, setup.servos, seed, family)
    if guessed := guessed_joints(setup.servos, family):
        MESSAGES.print(
            f"what the servos {', '.join(guessed)} move is a guess: neither their names nor "
            "`positive` in the face's YAML say it",
        )
    return robot
