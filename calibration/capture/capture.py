"""Poses and what the tracker saw of them; moving the robot through a plan and keeping every pose.

Knows no bus: `move` and `measure` are functions that somebody else makes.
"""

import json
import os
from collections.abc import Callable, Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from calibration.calibration import CalibrationError
from calibration.capture.capture_plan import PosePlan
from lipsync.arrays import Array
from lipsync.output_file import write_whole

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
    not recorded. n_planned: poses of the plan, those left out among them.
    """

    servo_names: tuple[str, ...]
    marker_names: tuple[str, ...]
    goals_deg: Array
    from_below: Array
    markers_mm: Array
    stalled: tuple[str, ...] = ()
    n_planned: int = 0

    def __len__(self) -> int:
        return len(self.goals_deg)


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
    where it stopped; a file of another plan is refused. arrived hears of each pose before it is
    measured; progress hears the number of poses done.
    """
    poses = [] if keep is None else read_kept(keep, plan, marker_names)
    on = Robot(move, measure, arrived, progress)
    return gather(plan, marker_names, take_poses(plan, marker_names, on, poses, keep))


@dataclass(frozen=True, slots=True)
class Robot:
    """All that a capture knows of a robot and its tracker.

    strained: which servo pulls with all the current that it may draw, None where none does or
    nobody measures.
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
                on.move(plan.start_deg[index])
                reached_deg = on.move(plan.goals_deg[index])
                on.arrived(index, reached_deg)
                # As exact as they are kept: a capture that goes on from a file is the same.
                seen_mm, stands_deg = np.round(on.measure(), 4), np.round(reached_deg, 4)
                poses.append(CapturedPose(index, stands_deg, seen_mm))
                if keep is not None:
                    _append(keep, poses[-1], plan, marker_names)
                if index in pressing and on.strained() is not None:
                    left_out = set(pressing)
            on.progress(len(poses))
    finally:
        on.move(np.zeros(len(plan.servo_names)))
    return poses


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
    )


#: How `_append` begins a line; what begins otherwise is no pose cut short.
_LINE_HEAD = '{"pose": '


def read_kept(
    keep: Path, plan: PosePlan, marker_names: tuple[str, ...], *, goes_on: bool = False
) -> list[CapturedPose]:
    """The poses in a kept file; a last line that a power cut left unfinished is dropped.

    goes_on: the plan will be continued, and poses beyond it are left for later.
    Raises CalibrationError for a file of another plan or a damaged one.
    """
    if not keep.exists():
        return []
    poses = []
    try:
        lines = keep.read_text(encoding="utf-8").split("\n")
    except (OSError, UnicodeDecodeError) as error:
        raise CalibrationError(f"{keep}: not readable as kept poses; name another file") from error
    for number, line in enumerate(lines[:-1]):
        try:
            content = json.loads(line)
            if not (goes_on and int(str(content["pose"])) >= len(plan)):
                poses.append(_parse(content, plan, marker_names))
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
    return poses


def _parse(line: dict[str, object], plan: PosePlan, marker_names: tuple[str, ...]) -> CapturedPose:
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


def _append(keep: Path, pose: CapturedPose, plan: PosePlan, marker_names: tuple[str, ...]) -> None:
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
