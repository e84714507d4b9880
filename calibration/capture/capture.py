"""Plans of robot poses from which a face is learnt, and the capture of markers in each pose.

Every pose is reached by a short last step from a known side of each joint, so that backlash lies on
a known side too: from below, a joint's horn lags by half the backlash; from above, it leads by
half. Poses are thereby independent of one another, and an interrupted capture, of which every pose
is kept, can be resumed. Talks to no bus: `move` and `measure` are functions of the caller.
Loads SciPy; the live path never does.
"""

import json
import os
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import qmc

from calibration.calibration import CalibrationError, CouplingRule, keep_rules
from calibration.mouth_servos import STALL_DEG, JointRange, limits_of
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
_LEAST_TO_REPEAT = 16


@dataclass(frozen=True, slots=True)
class PosePlan:
    """Poses in the order in which they are taken, all within the joint limits.

    goals_deg: (n, n_servos); from_below: (n, n_servos), 1 or -1: the side that the last step comes
    from; start_deg: (n, n_servos), where the last step begins. ladders: (n,), the number of the
    ladder (poses that close the lips step by step), from 1, that a pose belongs to, 0 for none;
    empty where the plan has no ladders.
    """

    servo_names: tuple[str, ...]
    goals_deg: Array
    from_below: Array
    start_deg: Array
    ladders: Indices = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    def __len__(self) -> int:
        return len(self.goals_deg)


def least_poses(n_servos: int, per_sweep: int = _FEWEST_PER_SWEEP) -> int:
    """Return the least number of poses of a plan for `n_servos` joints.

    They are 2 in neutral, `per_sweep` of each joint alone, and as many in which all joints move.
    """
    return _NEUTRAL_POSES + 2 * per_sweep * n_servos


def usual_poses(n_servos: int) -> int:
    """Return the fewest poses of a plan in which every joint is alone from below and from above."""
    return least_poses(n_servos, _POSES_PER_SWEEP)


def plan_poses(
    joints: Sequence[JointRange],
    n_poses: int,
    *,
    rules: Sequence[CouplingRule] = (),
    seed: int = 0,
) -> PosePlan:
    """Return a plan of `n_poses`: neutral, every joint alone from both sides, then random poses.

    The random poses are a Latin hypercube over all joints. With fewer poses than `usual_poses`,
    each joint is alone in one pose only, from below. With a hypercube of 16 poses or more, neutral
    is repeated in its middle and at its end. rules: coupling rules; a pose that breaks one is
    scaled towards neutral. seed: of the random poses and the sides they are reached from. Raises
    CalibrationError for fewer poses than `least_poses`.
    """
    least = least_poses(len(joints))
    if n_poses < least:
        raise CalibrationError(
            f"{n_poses} poses are too few for {len(joints)} servos; ask for {least} at least"
        )
    low, high = _range_with_lead_in(joints)
    is_short = n_poses < usual_poses(len(joints))
    sweeps_deg, sweep_side = _sweeps(low, high, _FEWEST_PER_SWEEP if is_short else _POSES_PER_SWEEP)
    n_random = n_poses - len(sweeps_deg)
    rng = np.random.default_rng(seed)
    # Each pose a point of the unit cube, one axis per joint.
    unit_poses = qmc.LatinHypercube(len(joints), rng=rng).random(n_random)
    goals_deg = np.concatenate([sweeps_deg, low + unit_poses * (high - low)])
    side = np.concatenate([sweep_side, rng.choice([-1.0, 1.0], (n_random, len(joints)))])
    if n_random >= _LEAST_TO_REPEAT:
        # The same pose again: what drifted, slipped or was moved meanwhile shows.
        for repeat in (len(sweeps_deg) + n_random // 2, len(goals_deg) - 1):
            goals_deg[repeat], side[repeat] = 0.0, 1.0
    return plan_of_poses(joints, goals_deg, side, rules)


def plan_around(
    goals_deg: Array,
    joints: Sequence[JointRange],
    *,
    rules: Sequence[CouplingRule] = (),
    seed: int | None = 0,
) -> PosePlan:
    """Return a plan of the given poses, each joint moved to its goal from below or above at random.

    The last step from either side shows the joint's backlash.

    Parameters
    ----------
    goals_deg : Array
        (n, n_servos) degrees; clipped to the limits and rules.
    joints : Sequence[JointRange]
        Limits of the joints.
    rules : Sequence[CouplingRule]
        Rules between joints (`prevent:` of the YAML).
    seed : int | None
        Seed of the random sides; None: all from below.

    Returns
    -------
    PosePlan
        A plan of n poses, in degrees.
    """
    side = np.ones_like(goals_deg)
    if seed is not None:
        side = np.random.default_rng([seed, 1]).choice([-1.0, 1.0], goals_deg.shape)
    return plan_of_poses(joints, goals_deg, side, rules)


def ends_alone(joints: Sequence[JointRange], joint: int) -> Array:
    """Return two poses with one joint near either end of its range and all others at 0 degrees.

    Parameters
    ----------
    joints : Sequence[JointRange]
        Ranges.
    joint : int
        Number of the joint that moves.

    Returns
    -------
    Array
        (2, n_servos) degrees, the lower end first.
    """
    ends_deg = np.zeros((2, len(joints)))
    ends_deg[:, joint] = [end[joint] for end in _range_with_lead_in(joints)]
    return ends_deg


def plan_rows(plan: PosePlan, rows: Sequence[int]) -> PosePlan:
    """Return a plan of the poses in `rows` only, in that order."""
    return PosePlan(plan.servo_names, *(each[list(rows)] for each in _arrays(plan)))


def joined(first: PosePlan, second: PosePlan) -> PosePlan:
    """Return one plan of the poses of `first` followed by those of `second`."""
    parts = zip(_arrays(first), _arrays(second), strict=True)
    return PosePlan(first.servo_names, *(np.concatenate(part) for part in parts))


def _arrays(plan: PosePlan) -> tuple[Any, ...]:
    return plan.goals_deg, plan.from_below, plan.start_deg, ladders_of(plan)


def plan_of_poses(
    joints: Sequence[JointRange], goals_deg: Array, side: Array, rules: Sequence[CouplingRule]
) -> PosePlan:
    """Return a plan of poses within limits and rules, each with a start up to 3 degrees before it.

    Parameters
    ----------
    joints, rules : Sequence[JointRange], Sequence[CouplingRule]
        Limits of the joints, and rules between them; goals are clipped to both.
    goals_deg : Array
        (n, n_servos) degrees.
    side : Array
        (n, n_servos): the side that a joint comes from, 1 below, -1 above.

    Returns
    -------
    PosePlan
        A plan of n poses, in degrees.
    """
    limits = limits_of(joints)
    goals_deg = np.array([keep_rules(rules, goal) for goal in np.clip(goals_deg, *limits)])
    start_deg = np.clip(goals_deg - LEAD_IN_DEG * side, *limits)
    start_deg = np.array([keep_rules(rules, start) for start in start_deg])
    return PosePlan(tuple(j.name for j in joints), goals_deg, side, start_deg)


def _range_with_lead_in(joints: Sequence[JointRange]) -> tuple[Array, Array]:
    """Return least and most angles, (n_servos,) each, that leave room for a last step to a pose."""
    low, high = limits_of(joints)
    room = np.minimum(LEAD_IN_DEG, (high - low) / 4)
    return np.minimum(low + room, 0.0), np.maximum(high - room, 0.0)


def _sweeps(low: Array, high: Array, per_sweep: int) -> tuple[Array, Array]:
    """Return goals and sides, each (n, n_servos), of neutral and of every joint alone in turn.

    `low`, `high`: each joint's least and most angle. A joint that is alone goes 0.6 of the way to
    its wider end, `per_sweep` times. Sides: 1 reached from below, -1 from above.
    """
    n_servos = len(low)
    wider = np.where(high >= -low, high, low)
    goals = np.zeros((_NEUTRAL_POSES + per_sweep * n_servos, n_servos))
    side = np.ones_like(goals)
    # Neutral twice: once from below, once from above.
    side[1] = -1.0
    for joint in range(n_servos):
        row = _NEUTRAL_POSES + per_sweep * joint
        goals[row : row + per_sweep, joint] = _SWEEP_SHARE * wider[joint]
        side[row + 1 : row + per_sweep, joint] = -1.0
    return goals, side


#: Go to joint degrees (n_servos,), at a speed the face's owner holds safe, settle, and give back
#: where the encoders are.
Move = Callable[[Array], Array]
#: Hears which pose of the plan stands, counted from 0, and where the encoders are.
Arrived = Callable[[int, Array], None]
#: The markers now, (n_markers, 3) millimetres; NaN for a point that the tracker lost.
Measure = Callable[[], Array]


@dataclass(frozen=True, slots=True)
class Capture:
    """Captured poses and their markers.

    goals_deg, from_below: (n, n_servos); markers_mm: (n, n_markers, 3), NaN where lost. stalled:
    one line for each pose that was left out because a joint did not reach its goal, or one for all
    that were not recorded. n_planned: number of poses in the plan, poses left out included. rows:
    the plan's rows of these poses; empty where they were read from files. ladders: as in
    PosePlan.
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
    """Return the ladder number of each pose, (n,); 0 for a pose of no ladder.

    A ladder is a series of poses that close the lips step by step.
    """
    return poses.ladders if len(poses.ladders) else np.zeros(len(poses), dtype=np.int64)


def outside_ladders(capture: Capture) -> Capture:
    """Return the capture without the poses of ladders, which close the lips step by step."""
    is_outside = ladders_of(capture) == 0
    return replace(
        capture,
        goals_deg=capture.goals_deg[is_outside],
        from_below=capture.from_below[is_outside],
        markers_mm=capture.markers_mm[is_outside],
        rows=tuple(np.array(capture.rows)[is_outside].tolist()) if capture.rows else (),
        ladders=ladders_of(capture)[is_outside],
    )


@dataclass(frozen=True, slots=True)
class CapturedPose:
    """One captured pose: its row in the plan, encoder angles in degrees and markers in mm."""

    index: int
    reached_deg: Array
    markers_mm: Array


#: How a line begins; what begins otherwise is no pose cut short.
_LINE_HEAD = '{"pose": '
#: Goals are written with four digits.
_SAME_DEG = 1e-3


@dataclass(frozen=True, slots=True)
class KeptPoses:
    """Captured poses in a file, a JSON line each; the latest line of a pose counts.

    path: None: nothing is kept. first: the number of the plan's first pose in the file, for poses
    that are taken after those of another plan. mounting: a text that differs for servos that are
    mounted otherwise, whose poses are refused.
    """

    path: Path | None = None
    first: int = 0
    mounting: str = ""

    def read(self, plan: PosePlan, marker_names: tuple[str, ...]) -> list[CapturedPose]:
        """Return the poses of `plan` in the file; remove an unfinished last line from the file.

        Empty if there is no file. Lines from the first pose beyond the plan on are ignored, because
        a capture extends its plan after the first poses. Raises CalibrationError for a damaged
        file, or one of another plan or mounting.
        """
        poses: dict[int, CapturedPose] = {}
        for number, content in self._lines():
            try:
                index = int(str(content["pose"])) - self.first
                if index >= len(plan):
                    break
                if index >= 0:
                    poses[index] = self._parse_pose(content, index, plan, marker_names)
            except (ValueError, KeyError, TypeError, IndexError, RecursionError) as error:
                raise self._not_a_pose_error(number) from error
        return list(poses.values())

    def add(self, pose: CapturedPose, plan: PosePlan, marker_names: tuple[str, ...]) -> None:
        """Append a pose of `plan`. Raises CalibrationError where the file cannot be written."""
        if self.path is None:
            return
        points = [
            [float(f"{v:.4f}") if np.isfinite(v) else None for v in place]
            for place in pose.markers_mm
        ]
        line = {
            "pose": self.first + pose.index,
            "servos": plan.servo_names,
            "mounting": self.mounting,
            "markers": marker_names,
            "goals_deg": [float(f"{v:.4f}") for v in plan.goals_deg[pose.index]],
            "from_below": plan.from_below[pose.index].tolist(),
            "ladder": int(ladders_of(plan)[pose.index]),
            "reached_deg": [float(f"{v:.4f}") for v in pose.reached_deg],
            "markers_mm": points,
        }
        try:
            with self.path.open("a", encoding="utf-8") as file:
                file.write(json.dumps(line) + "\n")
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise CalibrationError(f"{self.path}: cannot be written: {error.strerror}") from error

    def after(self, n_planned: int, plan: PosePlan) -> "KeptPoses":
        """Return the file for a plan whose poses are numbered after `n_planned` others.

        Numbers under which the file has poses with other goals are passed over, a whole plan at a
        time, so that poses of an earlier plan are kept.
        """
        stored = {int(line["pose"]): line for _, line in self._lines()}
        first = n_planned
        while not all(
            row + first not in stored or _has_goals(stored[row + first], plan.goals_deg[row])
            for row in range(len(plan))
        ):
            first += len(plan)
        return replace(self, first=first)

    def markers_mm(self) -> Mapping[int, Mapping[str, Array]]:
        """Return the markers (3,) mm of every pose in the file, by its number and their names.

        A marker that was not seen is NaN. Raises CalibrationError for a damaged file.
        """
        found: dict[int, Mapping[str, Array]] = {}
        for number, line in self._lines():
            try:
                places = (np.array(place, dtype=np.float64) for place in line["markers_mm"])
                found[int(line["pose"])] = dict(zip(line["markers"], places, strict=True))
            except (ValueError, KeyError, TypeError) as error:
                raise self._not_a_pose_error(number) from error
        return found

    def capture(self) -> Capture:
        """Return all poses in the file, which a design's user may have got without their plan.

        Raises CalibrationError without a file, or for one that this version did not keep.
        """
        lines = {int(line["pose"]): line for _, line in self._lines()}
        try:
            first, *_ = content = [lines[number] for number in sorted(lines)]
            goals_deg = np.array([line["goals_deg"] for line in content], dtype=np.float64)
            side = np.array([line["from_below"] for line in content], dtype=np.float64)
            ladders = np.array([line["ladder"] for line in content], dtype=np.int64)
            plan = PosePlan(tuple(first["servos"]), goals_deg, side, goals_deg, ladders)
            names = tuple(first["markers"])
            of_any = replace(self, mounting=first["mounting"])
            poses = [of_any._parse_pose(each, n, plan, names) for n, each in enumerate(content)]
        except (ValueError, KeyError, TypeError) as error:
            raise CalibrationError(
                f"{self.path}: not the poses of one robot that `lipservo calibrate measure` of "
                "this version kept; measure the design anew, or leave out --tracker"
            ) from error
        return gather(plan, names, poses)

    def _lines(self) -> Iterator[tuple[int, dict[str, Any]]]:
        """Yield the number, from 1, and parsed content of each line of the file, if there is one.

        An unfinished last line is removed from the file first. Raises CalibrationError for a file
        of anything else.
        """
        if self.path is None or not self.path.exists():
            return
        try:
            lines = self.path.read_text(encoding="utf-8").split("\n")
        except (OSError, UnicodeDecodeError) as error:
            raise CalibrationError(
                f"{self.path}: not a file of captured poses; name another file"
            ) from error
        if lines[-1]:  # cut short while writing, or a file of somebody else's
            if not lines[-1].startswith(_LINE_HEAD[: len(lines[-1])]):
                raise self._not_a_pose_error(len(lines))
            write_whole(self.path, "".join(line + "\n" for line in lines[:-1]))
        for number, line in enumerate(lines[:-1], start=1):
            try:
                content = json.loads(line)
                int(str(content["pose"]))
            except (ValueError, KeyError, TypeError, RecursionError) as error:
                raise self._not_a_pose_error(number) from error
            yield number, content

    def _not_a_pose_error(self, number: int) -> CalibrationError:
        return CalibrationError(
            f"{self.path}, line {number}: not a pose of this face, as its servos are mounted now, "
            "and plan; name another file or delete this one"
        )

    def _parse_pose(
        self, line: Mapping[str, Any], index: int, plan: PosePlan, marker_names: tuple[str, ...]
    ) -> CapturedPose:
        """Return the captured pose that one parsed JSON line of the file holds.

        index: the pose's row in `plan`. Raises ValueError for a pose of another face, mounting or
        plan, or with another number of markers. Lines of older versions name no mounting.
        """
        face = line["servos"], line["markers"], line.get("mounting", self.mounting)
        if face != (list(plan.servo_names), list(marker_names), self.mounting):
            raise ValueError("the pose is of another face, or of servos mounted otherwise")
        if not _has_goals(line, plan.goals_deg[index]):
            raise ValueError("the pose is of another plan")
        points = np.array(line["markers_mm"], dtype=np.float64)  # null becomes NaN
        if points.shape != (len(marker_names), 3):
            raise ValueError("the pose has another number of markers")
        return CapturedPose(index, np.array(line["reached_deg"], dtype=np.float64), points)


def _has_goals(line: Mapping[str, Any], goals_deg: Array) -> bool:
    file_deg = np.array(line["goals_deg"], dtype=np.float64)
    return file_deg.shape == goals_deg.shape and np.allclose(file_deg, goals_deg, atol=_SAME_DEG)


#: Nothing is kept.
NOT_KEPT = KeptPoses()


def capture_poses(
    plan: PosePlan,
    marker_names: tuple[str, ...],
    move: Move,
    measure: Measure,
    *,
    keep: Path | None = None,
) -> Capture:
    """Move through the plan, measure every pose, and leave the robot at its neutral.

    move, measure: as in `Robot`. keep: file to which each pose is written at once, one line a pose,
    so that an interrupted capture can be resumed from it; None: nothing is written. Raises
    CalibrationError for a `keep` of another plan.
    """
    kept = KeptPoses(keep)
    poses = kept.read(plan, marker_names)
    robot = Robot(move, measure)
    return gather(plan, marker_names, take_poses(plan, marker_names, robot, poses, kept))


@dataclass(frozen=True, slots=True)
class Robot:
    """The functions through which a capture moves and measures a robot.

    move: goes to joint angles, (n_servos,) degrees, and returns those reached; measure: returns the
    markers, (n_markers, 3) mm; arrived: called with row and reached angles of a pose; progress:
    called with the number of poses done; strained: returns the name of a servo that draws all the
    current that it may, None where no servo does or the load is not measured.
    """

    move: Move
    measure: Measure
    arrived: Arrived = lambda *_: None
    progress: Callable[[int], None] = lambda _: None
    strained: Callable[[], str | None] = lambda: None


def take_poses(
    plan: PosePlan,
    marker_names: tuple[str, ...],
    robot: Robot,
    poses: list[CapturedPose],
    kept: KeptPoses = NOT_KEPT,
    pressing: Collection[int] = (),
    left_out: set[int] | None = None,
) -> list[CapturedPose]:
    """Return `poses` and those of the plan missing from `poses`, which the robot moves to now.

    The robot is at neutral afterwards. kept: the file to which each new pose is added. pressing:
    rows of poses that close the lips farther and farther; once a servo is strained in one of these,
    the remaining ones are left out. left_out: rows that earlier calls have left out for that; those
    of this call are added.
    """
    poses = list(poses)
    done = {pose.index for pose in poses}
    skipped = set() if left_out is None else left_out
    if skipped & set(pressing):  # strained before: no farther
        skipped.update(pressing)
    try:
        for index in range(len(plan)):
            if index not in done and index not in skipped:
                poses.append(take_pose(plan, index, robot))
                kept.add(poses[-1], plan, marker_names)
                if index in pressing and robot.strained() is not None:
                    skipped.update(pressing)
            robot.progress(len(poses))
    finally:
        robot.move(np.zeros(len(plan.servo_names)))
    return poses


def take_pose(plan: PosePlan, index: int, robot: Robot) -> CapturedPose:
    """Move the robot to row `index` of the plan, by the row's start; return the measured pose."""
    robot.move(plan.start_deg[index])
    reached_deg = robot.move(plan.goals_deg[index])
    robot.arrived(index, reached_deg)
    # Rounded as in the file, so that a capture resumed from a file is the same.
    return CapturedPose(index, np.round(reached_deg, 4), np.round(robot.measure(), 4))


def stalled_joint(plan: PosePlan, index: int, reached_deg: Array) -> str | None:
    """Return a line on the joint that stalled on its way to a row of the plan; None if none did.

    Parameters
    ----------
    plan : PosePlan
        The poses.
    index : int
        The row.
    reached_deg : Array
        (n_servos,) degrees, by the encoders.

    Returns
    -------
    str | None
        The pose, the joint, where it stopped and its goal.
    """
    missed_deg = np.abs(reached_deg - plan.goals_deg[index])
    if missed_deg.max() <= STALL_DEG:
        return None
    joint = int(missed_deg.argmax())
    return (
        f"pose {index + 1}: {plan.servo_names[joint]} stopped at {reached_deg[joint]:.1f} of "
        f"{plan.goals_deg[index, joint]:.1f} deg"
    )


def gather(plan: PosePlan, marker_names: tuple[str, ...], poses: list[CapturedPose]) -> Capture:
    """Return `poses` of the plan as one capture, without those in which a joint stalled.

    A joint is stalled where its encoder is more than STALL_DEG from its goal.
    """
    stalled: list[str] = []
    good: list[CapturedPose] = []
    for pose in sorted(poses, key=lambda p: p.index):
        stall = stalled_joint(plan, pose.index, pose.reached_deg)
        if stall is None:
            good.append(pose)
        else:
            stalled.append(stall)
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
