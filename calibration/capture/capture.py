"""Poses that a robot is moved through to learn its face, and what the tracker saw of them.

Every pose is reached by a short last step from a known side of each joint, so that backlash lies on
a known side too: from below a joint's horn lags by half the backlash, from above it leads by half.
Poses are thereby independent of one another, and a capture, of which every pose is kept, can stop
and go on. Knows no bus: `move` and `measure` are functions of the caller.
Loads SciPy; the live path never does.
"""

import json
import os
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.stats import qmc

from calibration.calibration import CalibrationError, CouplingRule, keep_rules
from calibration.mouth_servos import JointRange
from lipsync.arrays import Array, Indices
from lipsync.output_file import write_whole

#: The last step to a pose; more than twice the backlash of a printed gear train.
LEAD_IN_DEG = 3.0
#: How far along its range a single-joint sweep goes: far enough to be seen above the tracker's
#: noise, not so far that a limit set a little wrong does harm.
_SWEEP_SHARE = 0.6
#: Poses a joint takes in the sweeps (the same angle from below and from above), and where every
#: pose is dear.
_POSES_PER_SWEEP, _FEWEST_PER_SWEEP = 2, 1
_NEUTRAL_POSES = 2
#: Neutral is taken again in the middle and at the end where so many poses are left for the rest.
_LEAST_CUBE = 16


@dataclass(frozen=True, slots=True)
class PosePlan:
    """Poses in their order, all within the limits.

    goals_deg: (n, n_servos); from_below: (n, n_servos), 1 or -1: the side that the last step comes
    from; start_deg: (n, n_servos), where that step begins. ladders: (n,), of poses that close the
    lips step by step from which ladder they are, from 1; 0 for all others; empty for none at all.
    """

    servo_names: tuple[str, ...]
    goals_deg: Array
    from_below: Array
    start_deg: Array
    ladders: Indices = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    def __len__(self) -> int:
        return len(self.goals_deg)


def least_poses(n_servos: int, per_sweep: int = _FEWEST_PER_SWEEP) -> int:
    """The fewest poses that a face of so many servos is learnt from: its sweeps, and as many."""
    return _NEUTRAL_POSES + 2 * per_sweep * n_servos


def usual_poses(n_servos: int) -> int:
    """The fewest with every joint seen alone from both sides; what is more may lie in speech."""
    return least_poses(n_servos, _POSES_PER_SWEEP)


def plan_poses(
    joints: Sequence[JointRange],
    n_poses: int,
    *,
    rules: Sequence[CouplingRule] = (),
    seed: int = 0,
) -> PosePlan:
    """Neutral, every joint alone from both sides, then a Latin hypercube within the limits.

    Of few poses each joint is alone in one, from below. Neutral comes again in the middle of the
    hypercube and at its end.
    rules: what the joints must not do together; a pose that breaks one is scaled towards neutral.
    Raises CalibrationError for fewer poses than `least_poses`.
    """
    least = least_poses(len(joints))
    if n_poses < least:
        raise CalibrationError(
            f"{n_poses} poses are too few for {len(joints)} servos; ask for {least} or more"
        )
    low, high = _inside(joints)
    few = n_poses < usual_poses(len(joints))
    single, single_side = _sweeps(low, high, _FEWEST_PER_SWEEP if few else _POSES_PER_SWEEP)
    n_cube = n_poses - len(single)
    rng = np.random.default_rng(seed)
    cube = qmc.LatinHypercube(len(joints), rng=rng).random(n_cube)
    goals_deg = np.concatenate([single, low + cube * (high - low)])
    side = np.concatenate([single_side, rng.choice([-1.0, 1.0], (n_cube, len(joints)))])
    if n_cube >= _LEAST_CUBE:
        # The same pose again: what drifted, slipped or was moved meanwhile shows.
        for repeat in (len(single) + n_cube // 2, len(goals_deg) - 1):
            goals_deg[repeat], side[repeat] = 0.0, 1.0
    return reached_from(joints, goals_deg, side, rules)


def plan_around(
    goals_deg: Array,
    joints: Sequence[JointRange],
    *,
    rules: Sequence[CouplingRule] = (),
    seed: int | None = 0,
) -> PosePlan:
    """Plan given poses, each joint reached from a side drawn by `seed`.

    Parameters
    ----------
    goals_deg : Array
        (n, n_servos).
    joints,rules : Sequence[JointRange]
        Limits that the plan keeps.
    seed : int | None
        None: all from below.

    Returns
    -------
    PosePlan
        A plan of n poses, in degrees.
    """
    side = np.ones_like(goals_deg)
    if seed is not None:
        side = np.random.default_rng([seed, 1]).choice([-1.0, 1.0], goals_deg.shape)
    return reached_from(joints, goals_deg, side, rules)


def ends_alone(joints: Sequence[JointRange], joint: int) -> Array:
    """Return the poses with one joint at either end of its range, with room for the last step.

    Parameters
    ----------
    joints : Sequence[JointRange]
        Ranges.
    joint : int
        Its number.

    Returns
    -------
    Array
        (2, n_servos) degrees.
    """
    ends_deg = np.zeros((2, len(joints)))
    ends_deg[:, joint] = [end[joint] for end in _inside(joints)]
    return ends_deg


def plan_rows(plan: PosePlan, rows: Sequence[int]) -> PosePlan:
    """Some poses of a plan."""
    chosen = list(rows)
    return replace(
        plan,
        goals_deg=plan.goals_deg[chosen],
        from_below=plan.from_below[chosen],
        start_deg=plan.start_deg[chosen],
        ladders=ladders_of(plan)[chosen],
    )


def joined(first: PosePlan, second: PosePlan) -> PosePlan:
    """Join two plans, one after the other."""
    return PosePlan(
        first.servo_names,
        np.concatenate([first.goals_deg, second.goals_deg]),
        np.concatenate([first.from_below, second.from_below]),
        np.concatenate([first.start_deg, second.start_deg]),
        np.concatenate([ladders_of(first), ladders_of(second)]),
    )


def reached_from(
    joints: Sequence[JointRange], goals_deg: Array, side: Array, rules: Sequence[CouplingRule]
) -> PosePlan:
    """Plan poses within limits and rules, each with the beginning of its last step.

    Parameters
    ----------
    joints,rules : Sequence[JointRange]
        Limits that the plan keeps.
    goals_deg : Array
        (n, n_servos).
    side : Array
        (n, n_servos): 1 from below, -1 from above.

    Returns
    -------
    PosePlan
        A plan of n poses, in degrees.
    """
    limits = np.array([[j.min_deg for j in joints], [j.max_deg for j in joints]])
    goals_deg = np.array([keep_rules(rules, goal) for goal in np.clip(goals_deg, *limits)])
    start_deg = np.clip(goals_deg - LEAD_IN_DEG * side, *limits)
    start_deg = np.array([keep_rules(rules, start) for start in start_deg])
    return PosePlan(tuple(j.name for j in joints), goals_deg, side, start_deg)


def _inside(joints: Sequence[JointRange]) -> tuple[Array, Array]:
    """The range that leaves room for the last step from either side, as far as there is any."""
    low = np.array([j.min_deg for j in joints])
    high = np.array([j.max_deg for j in joints])
    room = np.minimum(LEAD_IN_DEG, (high - low) / 4)
    return np.minimum(low + room, 0.0), np.maximum(high - room, 0.0)


def _sweeps(low: Array, high: Array, per_sweep: int) -> tuple[Array, Array]:
    """Goals and sides of the neutral poses and of every joint alone, at its wider end."""
    n_servos = len(low)
    wider = np.where(high >= -low, high, low)
    goals = np.zeros((_NEUTRAL_POSES + per_sweep * n_servos, n_servos))
    side = np.ones_like(goals)
    side[1] = -1.0
    for joint in range(n_servos):
        up = _NEUTRAL_POSES + per_sweep * joint
        goals[up : up + per_sweep, joint] = _SWEEP_SHARE * wider[joint]
        side[up + 1 : up + per_sweep, joint] = -1.0
    return goals, side


#: Go to joint degrees (n_servos,), at a speed the face's owner holds safe, settle, and give back
#: where the encoders are.
Move = Callable[[Array], Array]
#: Hears which pose of the plan stands, counted from 0, and where the encoders are.
Arrived = Callable[[int, Array], None]
#: The markers now, (n_markers, 3) millimetres; NaN for a point that the tracker lost.
Measure = Callable[[], Array]

#: A servo farther from its goal than this after settling has met something. A few times what a
#: proportional controller leaves under the pull of a skin.
STALL_DEG = 3.0


@dataclass(frozen=True, slots=True)
class Capture:
    """Captured poses.

    goals_deg, from_below: (n, n_servos); markers_mm: (n, n_markers, 3), NaN where lost. stalled: a
    line for each pose that was left out because a joint did not get there, or for those that were
    not recorded. n_planned: poses of the plan, those left out among them. rows: of the plan, which
    of its poses these are, where they were captured pose by pose. ladders: as in the plan.
    """

    servo_names: tuple[str, ...]
    marker_names: tuple[str, ...]
    goals_deg: Array
    from_below: Array
    markers_mm: Array
    stalled: tuple[str, ...] = ()
    n_planned: int = 0
    rows: tuple[int, ...] = ()
    ladders: Indices = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    def __len__(self) -> int:
        return len(self.goals_deg)


def ladders_of(poses: PosePlan | Capture) -> Indices:
    """(n,): of which ladder each pose is, 0: of none."""
    return poses.ladders if len(poses.ladders) else np.zeros(len(poses), dtype=np.int64)


def outside_ladders(capture: Capture) -> Capture:
    """The poses in which lips are not closed step by step."""
    free = ladders_of(capture) == 0
    return replace(
        capture,
        goals_deg=capture.goals_deg[free],
        from_below=capture.from_below[free],
        markers_mm=capture.markers_mm[free],
        rows=tuple(np.array(capture.rows)[free].tolist()) if capture.rows else (),
        ladders=ladders_of(capture)[free],
    )


@dataclass(frozen=True, slots=True)
class CapturedPose:
    """One pose of a plan, as it is kept: its number, the encoders, and the markers."""

    index: int
    reached_deg: Array
    markers_mm: Array


def capture_poses(
    plan: PosePlan,
    marker_names: tuple[str, ...],
    move: Move,
    measure: Measure,
    *,
    keep: Path | None = None,
    arrived: Arrived = lambda *_: None,
    progress: Callable[[int], None] = lambda _: None,
) -> Capture:
    """Move through the plan, measure every pose, and leave the robot at its neutral.

    keep: a file of one line a pose, written at once, so that a capture that was cut short goes on
    where it stopped; a file of another plan is refused. arrived is called for each pose before it
    is measured; progress is called with the number of poses done.
    """
    poses = [] if keep is None else read_kept(keep, plan, marker_names)
    on = Robot(move, measure, arrived, progress)
    return gather(plan, marker_names, take_poses(plan, marker_names, on, poses, keep))


@dataclass(frozen=True, slots=True)
class Robot:
    """All that a capture knows of a robot and its tracker.

    strained: which servo pulls with all the current that it may draw, None where none does or
    the load is not measured.
    """

    move: Move
    measure: Measure
    arrived: Arrived = lambda *_: None
    progress: Callable[[int], None] = lambda _: None
    strained: Callable[[], str | None] = lambda: None


def take_poses(
    plan: PosePlan,
    marker_names: tuple[str, ...],
    on: Robot,
    poses: list[CapturedPose],
    keep: Path | None,
    pressing: Collection[int] = (),
) -> list[CapturedPose]:
    """`poses` and those of the plan that are not among them, which are captured now.

    pressing: poses that close the lips farther and farther; once a servo is strained there, those
    that follow are left out.
    """
    poses = list(poses)
    done = {pose.index for pose in poses}
    left_out: set[int] = set()
    try:
        for index in range(len(plan)):
            if index not in done and index not in left_out:
                poses.append(take_pose(plan, index, on))
                if keep is not None:
                    keep_pose(keep, poses[-1], plan, marker_names)
                if index in pressing and on.strained() is not None:
                    left_out = set(pressing)
            on.progress(len(poses))
    finally:
        on.move(np.zeros(len(plan.servo_names)))
    return poses


def take_pose(plan: PosePlan, index: int, on: Robot) -> CapturedPose:
    """Go to a pose of the plan, from its side, and measure it."""
    on.move(plan.start_deg[index])
    reached_deg = on.move(plan.goals_deg[index])
    on.arrived(index, reached_deg)
    # As exact as they are kept: a capture that goes on from a file is the same.
    return CapturedPose(index, np.round(reached_deg, 4), np.round(on.measure(), 4))


def gather(plan: PosePlan, marker_names: tuple[str, ...], poses: list[CapturedPose]) -> Capture:
    """The capture that these poses of the plan make; poses with a stalled joint are left out."""
    stalled: list[str] = []
    good: list[CapturedPose] = []
    for pose in sorted(poses, key=lambda p: p.index):
        off_deg = np.abs(pose.reached_deg - plan.goals_deg[pose.index])
        if off_deg.max() <= STALL_DEG:
            good.append(pose)
            continue
        joint = int(off_deg.argmax())
        stalled.append(
            f"pose {pose.index + 1}: {plan.servo_names[joint]} stopped at "
            f"{pose.reached_deg[joint]:.1f} of {plan.goals_deg[pose.index, joint]:.1f} deg"
        )
    rows = [pose.index for pose in good]
    return Capture(
        servo_names=plan.servo_names,
        marker_names=marker_names,
        goals_deg=plan.goals_deg[rows],
        from_below=plan.from_below[rows],
        markers_mm=np.array([pose.markers_mm for pose in good]).reshape(-1, len(marker_names), 3),
        stalled=tuple(stalled),
        n_planned=len(plan),
        rows=tuple(rows),
        ladders=ladders_of(plan)[rows],
    )


#: How `keep_pose` begins a line; what begins otherwise is no pose cut short.
_LINE_HEAD = '{"pose": '


def read_kept(
    keep: Path, plan: PosePlan, marker_names: tuple[str, ...], *, goes_on: bool = False
) -> list[CapturedPose]:
    """The poses in a kept file; a last line that a power cut left unfinished is dropped.

    goes_on: the plan will be continued; the first pose beyond it, and all that was written after,
    are left for later: what follows was planned without them.
    Raises CalibrationError for a file of another plan or a damaged one.
    """
    if not keep.exists():
        return []
    poses: dict[int, CapturedPose] = {}
    try:
        lines = keep.read_text(encoding="utf-8").split("\n")
    except (OSError, UnicodeDecodeError) as error:
        raise CalibrationError(f"{keep}: not readable as kept poses; name another file") from error
    for number, line in enumerate(lines[:-1]):
        try:
            content = json.loads(line)
            if goes_on and int(str(content["pose"])) >= len(plan):
                break
            pose = _kept_pose(content, plan, marker_names)
            poses[pose.index] = pose
        except (ValueError, KeyError, TypeError, IndexError, RecursionError) as error:
            raise CalibrationError(
                f"{keep}, line {number + 1}: not a pose of this face and plan; "
                "name another file or remove this one"
            ) from error
    if lines[-1]:  # cut short while writing, or a file of somebody else's
        if not lines[-1].startswith(_LINE_HEAD[: len(lines[-1])]):
            raise CalibrationError(
                f"{keep}, line {len(lines)}: not a pose of this face and plan; "
                "name another file or remove this one"
            )
        write_whole(keep, "".join(line + "\n" for line in lines[:-1]))
    return list(poses.values())


def _kept_pose(
    line: dict[str, object], plan: PosePlan, marker_names: tuple[str, ...]
) -> CapturedPose:
    if line["servos"] != list(plan.servo_names) or line["markers"] != list(marker_names):
        raise ValueError("another face")
    index = int(str(line["pose"]))
    goals_deg = np.array(line["goals_deg"], dtype=np.float64)
    if not np.allclose(goals_deg, plan.goals_deg[index], atol=1e-3):
        raise ValueError("another plan")
    points = np.array(line["markers_mm"], dtype=np.float64)  # null becomes NaN
    if points.shape != (len(marker_names), 3):
        raise ValueError("wrong number of markers")
    return CapturedPose(index, np.array(line["reached_deg"], dtype=np.float64), points)


def keep_pose(
    keep: Path, pose: CapturedPose, plan: PosePlan, marker_names: tuple[str, ...]
) -> None:
    """Add a line to the kept poses; the last line of a pose counts. Raises CalibrationError."""

    def plain(points: Array) -> list[list[float | None]]:
        return [[float(f"{v:.4f}") if np.isfinite(v) else None for v in p] for p in points]

    line = {
        "pose": pose.index,
        "servos": plan.servo_names,
        "markers": marker_names,
        "goals_deg": [float(f"{v:.4f}") for v in plan.goals_deg[pose.index]],
        "reached_deg": [float(f"{v:.4f}") for v in pose.reached_deg],
        "markers_mm": plain(pose.markers_mm),
    }
    try:
        with keep.open("a", encoding="utf-8") as file:
            file.write(json.dumps(line) + "\n")
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise CalibrationError(f"{keep}: cannot be written: {error.strerror}") from error
