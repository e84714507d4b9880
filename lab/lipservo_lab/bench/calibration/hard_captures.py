"""Simulated robots without faults, seen by worse trackers: how many captures are refused.

Fifteen markers in place of 47; a millimetre of noise in each axis in place of half of one; one
reading in a hundred that is anywhere within three centimetres.

What can be wrong with a capture, done to elastic robots on purpose, and whether it is named.

Rightly: a message names the fault and, where a servo is to blame, that servo alone. Wrongly:
another servo or another fault is named. Else there was no message.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from calibration.calibration import CalibrationError
from calibration.capture.capture import Capture, Robot, capture_poses
from calibration.capture.sanity import check_capture
from calibration.fit.procedure import Procedure
from calibration.mouth_servos import MouthServos
from calibration.simulated.elastic_robot import ElasticFace
from calibration.simulated.robot import SENSOR_NOISE_MM, SimulatedRobot, Skin
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array
from lipsync.markers import MARKERS_47

_N_POSES = 60
_SLIP_DEG = 15.0
#: Words of which one must be in what is said, and none of the others' words may be.
_WORDS: Mapping[str, tuple[str, ...]] = {
    "dead": ("moves no marker", "stopped moving"),
    "stuck": ("stopped moving",),
    "torn": ("stopped moving",),
    "slipped": ("slipped",),
    "reversed": ("is reversed",),
    "reversed jaw": ("is reversed",),
    "lips exchanged": ("changed places", "exchanged"),
    "half scale": ("scale",),
    "double scale": ("scale",),
    "pixels": ("pixels",),
    "mirrored": ("mirrored",),
    "upside down": ("upside down",),
    "back to front": ("back to front",),
    "knocked": ("moved by", "another one than before"),
    "hand-held": ("moved by",),
}
#: Faults with a servo to blame.
_OF_A_SERVO = ("dead", "stuck", "torn", "slipped", "reversed", "reversed jaw")
#: Those that are also done in `measure`, in the second half of what it takes before the ladders.
_MEASURED = ", measured"
_IN_MEASURE = ("slipped", "torn")
#: Words of a jaw.
_JAW = ("opens", "closes")


@dataclass(frozen=True, slots=True)
class FaultCount:
    """How many faults were tried, named rightly, and named wrongly."""

    tried: int
    named: int
    misnamed: int


_COUNTED = fields(FaultCount)


def count_faults(
    model: FaceWithAnimPhos, face: Skin, servos: MouthServos, seed: int
) -> dict[str, FaultCount]:
    """Put every fault once into one robot, each in a capture of its own; return what was named.

    Result: by fault. The servo with the fault is drawn by the seed; a reversed jaw is the robot's
    first jaw.
    """
    rng = np.random.default_rng([seed, 23])
    drawn_joint = int(rng.integers(len(servos.joints)))
    jaws = [joint for joint, word in enumerate(servos.positive) if word in _JAW]
    counts = {}
    for fault in _WORDS:
        if fault == "reversed jaw" and not jaws:
            continue
        joint = jaws[0] if fault == "reversed jaw" else drawn_joint
        capture = _capture_with_fault(model, face, servos, fault, joint, seed)
        counts[fault] = _check_and_count(model, servos, fault, joint, capture)
    return counts


def count_measured_faults(
    model: FaceWithAnimPhos, face: Skin, servos: MouthServos, seed: int
) -> dict[str, FaultCount]:
    """Let each fault of `_IN_MEASURE` begin during a `measure` procedure; return what was named.

    Result: by fault. The servo is drawn by the seed.
    """
    joint = int(np.random.default_rng([seed, 23]).integers(len(servos.joints)))
    counts = {}
    for kind in _IN_MEASURE:
        fault = kind + _MEASURED
        try:
            capture = _capture_with_fault(model, face, servos, fault, joint, seed)
        except CalibrationError as error:  # refused before all of it was taken
            counts[fault] = _count_warnings(servos, kind, joint, [str(error)])
            continue
        counts[fault] = _check_and_count(model, servos, kind, joint, capture)
    return counts


def fault_figures(counts: Sequence[Mapping[str, FaultCount]]) -> dict[str, object]:
    """Return the shares of all faults that were named rightly and wrongly, and counts by fault.

    counts: of each robot, by fault.
    """
    all_counts = [count for robot in counts for count in robot.values()]
    tried = max(1, sum(count.tried for count in all_counts))
    each: dict[str, dict[str, int]] = {}
    for fault in (*_WORDS, *(kind + _MEASURED for kind in _IN_MEASURE)):
        tries = [robot[fault] for robot in counts if fault in robot]
        each[fault] = {f.name: sum(getattr(count, f.name) for count in tries) for f in _COUNTED}
    return {
        "faults_named": sum(count.named for count in all_counts) / tried,
        "faults_misnamed": sum(count.misnamed for count in all_counts) / tried,
        "faults": each,
    }


def _capture_with_fault(
    model: FaceWithAnimPhos,
    face: Skin,
    servos: MouthServos,
    fault: str,
    joint: int,
    seed: int,
) -> Capture:
    """Return the capture of a simulated robot that has one fault.

    `fault`: a key of `_WORDS`; with `_MEASURED` at its end the fault happens late in a whole
    `measure` procedure, which may raise CalibrationError. `joint`: index of the servo that has it.
    """
    robot = SimulatedRobot(face, noise_seed=seed)
    procedure = Procedure(model, servos.joints, _N_POSES, seed=seed, positive=servos.positive)
    plan = procedure.whole_range_plan()
    fault_pose, n_moves = len(plan) // 2, [0]
    if fault.endswith(_MEASURED):
        fault_pose = int(np.random.default_rng([seed, 43]).integers(_N_POSES // 2, _N_POSES))
    stuck_deg = [0.0]
    kind = fault.removesuffix(_MEASURED)

    def move(goal_deg: Array) -> Array:
        """Move the robot with the fault applied; return the goals themselves as reached angles.

        The procedure moves twice for each pose. goal_deg: (n_joints,) degrees.
        """
        pose, actual_deg = n_moves[0] // 2, goal_deg.copy()
        n_moves[0] += 1
        if kind == "dead" or (kind == "torn" and pose >= fault_pose):
            actual_deg[joint] = 0.0
        elif fault.startswith("reversed"):
            actual_deg[joint] = -actual_deg[joint]
        elif kind == "slipped" and pose >= fault_pose:
            actual_deg[joint] += _SLIP_DEG
        elif fault == "stuck":
            if pose >= fault_pose:
                actual_deg[joint] = stuck_deg[0]
            stuck_deg[0] = actual_deg[joint]
        robot.move(actual_deg)
        return goal_deg

    if fault.endswith(_MEASURED):
        return procedure.capture(MARKERS_47.names, Robot(move, robot.measure))
    capture = capture_poses(plan, MARKERS_47.names, move, robot.measure)
    return replace(capture, markers_mm=_as_tracked(fault, capture.markers_mm, seed))


def _as_tracked(fault: str, markers_mm: Array, seed: int) -> Array:
    """Return markers, (n_poses, n_markers, 3) mm, as a tracker with this fault would report them.

    Faults of servos leave the markers as they are.
    """
    rng = np.random.default_rng([seed, 29])
    disturbance_of: Mapping[str, Callable[[Array], Array]] = {
        "lips exchanged": _lips_exchanged,
        "half scale": lambda mm: 0.5 * mm,
        "double scale": lambda mm: 2.0 * mm,
        "pixels": lambda mm: mm * [6.0, -6.0, 0.0] + [640.0, 360.0, 0.0],
        "mirrored": lambda mm: mm * [-1.0, 1.0, 1.0],
        "upside down": lambda mm: mm * [1.0, -1.0, 1.0],
        "back to front": lambda mm: mm * [1.0, 1.0, -1.0],
        "knocked": lambda mm: _knocked(mm),
        "hand-held": lambda mm: mm + rng.normal(0.0, 4.0, (len(mm), 1, 3)),
    }
    return disturbance_of[fault](markers_mm) if fault in disturbance_of else markers_mm


def _lips_exchanged(markers_mm: Array) -> Array:
    upper, lower = MARKERS_47.upper_lip, MARKERS_47.lower_lip
    exchanged = markers_mm.copy()
    exchanged[:, [upper, lower]] = markers_mm[:, [lower, upper]]
    return exchanged


def _knocked(markers_mm: Array) -> Array:
    moved = markers_mm.copy()
    moved[len(moved) // 2 :] += [5.0, -3.0, 2.0]
    return moved


def _check_and_count(
    model: FaceWithAnimPhos, servos: MouthServos, fault: str, joint: int, capture: Capture
) -> FaultCount:
    """Check a capture; return whether its warnings, or the refusal's text, name the fault."""
    try:
        warnings = list(check_capture(capture, model, servos.positive).warnings)
    except CalibrationError as error:
        warnings = [str(error)]
    return _count_warnings(servos, fault, joint, warnings)


def _count_warnings(servos: MouthServos, fault: str, joint: int, warnings: list[str]) -> FaultCount:
    """Return one try's count: the fault named rightly, named wrongly, or not at all.

    Named rightly: a warning contains one of the fault's words (`_WORDS`), and the only servo named
    in warnings is the faulty one (none, for a fault that belongs to no servo). Named wrongly: there
    are other warnings. Those of weak and far-off servos do not count.
    """
    warnings = [
        line for line in warnings if " is weak or dead" not in line and "far off" not in line
    ]
    blamed = [name for name in servos.names if any(f"servo {name!r}" in line for line in warnings)]
    faulty = servos.names[joint]
    names_fault = any(word in line for line in warnings for word in _WORDS[fault])
    is_right = names_fault and blamed == ([faulty] if fault in _OF_A_SERVO else [])
    return FaultCount(1, int(is_right), int(bool(warnings) and not is_right))


_FEW = (
    "inner_lip_13", "inner_lip_14", "inner_lip_82", "inner_lip_87", "inner_lip_312",
    "inner_lip_317", "outer_lip_61", "outer_lip_291", "outer_lip_0", "outer_lip_17", "outer_lip_39",
    "outer_lip_269", "outer_lip_181", "outer_lip_405", "chin_199",
)  # fmt: skip
_OUTLIERS, _ANYWHERE_MM = 0.01, 30.0


@dataclass(frozen=True, slots=True)
class _Tracker:
    """A simulated tracker. marker_names: the markers that it sees.

    noise_mm: standard deviation of each coordinate; disturbed: changes a reading (n_markers, 3) mm.
    """

    marker_names: tuple[str, ...] = MARKERS_47.names
    noise_mm: float = SENSOR_NOISE_MM
    disturbed: Callable[[Array, np.random.Generator], Array] = lambda seen_mm, _: seen_mm


def _with_outliers(seen_mm: Array, rng: np.random.Generator) -> Array:
    is_outlier = rng.random((len(seen_mm), 1)) < _OUTLIERS
    return np.where(
        is_outlier, seen_mm + rng.uniform(-_ANYWHERE_MM, _ANYWHERE_MM, seen_mm.shape), seen_mm
    )


_TRACKERS: Mapping[str, _Tracker] = {
    "15 markers": _Tracker(marker_names=_FEW),
    "1 mm of noise": _Tracker(noise_mm=1.0),
    "1 % of outliers": _Tracker(disturbed=_with_outliers),
}


def refusals(
    model: FaceWithAnimPhos, face: ElasticFace, servos: MouthServos, seed: int
) -> dict[str, str | None]:
    """Return for each of `_TRACKERS` why it makes a healthy robot refused; None: it does not."""
    return {
        name: _refusal(model, face, servos, tracker, seed) for name, tracker in _TRACKERS.items()
    }


def _refusal(
    model: FaceWithAnimPhos, face: ElasticFace, servos: MouthServos, tracker: _Tracker, seed: int
) -> str | None:
    """Capture a simulated robot without faults as this tracker sees it.

    Return the error message if the capture is refused, else None.
    """
    robot = SimulatedRobot(face, noise_seed=seed, noise_mm=tracker.noise_mm)
    rng = np.random.default_rng([seed, 41])
    marker_rows = [MARKERS_47.names.index(name) for name in tracker.marker_names]
    procedure = Procedure(model, servos.joints, _N_POSES, seed=seed, positive=servos.positive)
    try:
        capture = procedure.capture(
            tracker.marker_names,
            Robot(robot.move, lambda: tracker.disturbed(robot.measure()[marker_rows], rng)),
        )
        check_capture(capture, model, servos.positive)
    except CalibrationError as error:
        return str(error)
    return None
