"""Pairs of markers whose names were exchanged, in every pose or in some: found and corrected.

A tracker that follows dots confuses neighbours now and then. Which two and in which pose follows
from the other poses; so the pose is captured again, and where three readings agree the two names
are exchanged.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from calibration.capture.attitude import turned_like
from calibration.capture.capture import (
    NOT_KEPT,
    Capture,
    CapturedPose,
    KeptPoses,
    PosePlan,
    Robot,
    gather,
    take_pose,
)
from calibration.capture.straight_lines import straight_lines
from lipsync.arrays import Array
from lipsync.face.model import FaceModel
from lipsync.markers import MARKERS_47

#: Swapped names must explain this part of what a pose leaves unexplained, and at least so much:
#: two markers 3 mm apart that change places are 3 mm off each, six times the noise.
_SWAP_SHARE, _SWAP_MM = 0.6, 3.0
_OUTER_LIPS = ("outer_lip_0", "outer_lip_17")
_INNER_LIPS = (
    ("inner_lip_13", "inner_lip_14"),
    ("inner_lip_82", "inner_lip_87"),
    ("inner_lip_312", "inner_lip_317"),
)
#: Inner and outer lips part together; so much the other way is an exchange.
_OPPOSED = -0.5


@dataclass(frozen=True, slots=True)
class Swap:
    """Two markers, by name, that exchanged positions; pose: counted from 0, None: in every pose."""

    one: str
    other: str
    pose: int | None = None

    @property
    def names(self) -> tuple[str, str]:
        """The names of both markers."""
        return self.one, self.other

    def description(self) -> str:
        """Return text for messages: both names, and the pose counted from 1, or `in every pose`."""
        where = "in every pose" if self.pose is None else f"in pose {self.pose + 1}"
        return f"{self.one!r} and {self.other!r} have changed places {where}"


def described_swaps(swaps: Sequence[Swap]) -> str:
    """Return the descriptions of all swaps as one text for messages, separated by semicolons."""
    return "; ".join(swap.description() for swap in swaps)


def swaps_refused(swaps: Sequence[Swap]) -> str:
    """Return the refusal of a capture with these swaps, all in one line, with the remedy."""
    return (
        f"markers {described_swaps(swaps)}; name them the other way round in the tracker, capture "
        "again, or add --accept where it was in single poses, and they are exchanged there"
    )


def exchanged(capture: Capture, swaps: Sequence[Swap]) -> Array:
    """Return the markers of a capture with the names in `swaps` exchanged back.

    Parameters
    ----------
    capture : Capture
        Capture of n poses.
    swaps : Sequence[Swap]
        Pairs of markers, each in one pose, not in every pose.

    Returns
    -------
    Array
        (n, n_markers, 3) mm.
    """
    markers_mm, names = capture.markers_mm.copy(), capture.marker_names
    for swap in swaps:
        pair = [names.index(swap.one), names.index(swap.other)]
        markers_mm[swap.pose, pair] = markers_mm[swap.pose, pair[::-1]]
    return markers_mm


def swapped_everywhere(capture: Capture, model: FaceModel) -> list[Swap]:
    """Return pairs of markers whose names are exchanged in every pose.

    A pair counts if the usual positions with its names exchanged are more like the speaker's rest,
    after each axis is moved and scaled. If there is none, inner lips are examined by how they move.
    """
    human_mm = model.markers_mm(model.rest[None])[0]
    known = [i for i, name in enumerate(capture.marker_names) if name in MARKERS_47.names]
    human_mm = human_mm[[MARKERS_47.names.index(capture.marker_names[i]) for i in known]]
    robot_mm = np.nanmedian(capture.markers_mm, axis=0)[known]

    def standardised(points_mm: Array) -> Array:
        """Return points (n, 3) less their median, each axis over its median distance from that."""
        centred = points_mm - np.median(points_mm, axis=0)
        return np.asarray(centred / np.maximum(np.median(np.abs(centred), axis=0), 1e-6))

    # The robot's usual shape less the speaker's, and that difference in the robot's mm.
    differences = standardised(robot_mm) - standardised(human_mm)
    size_mm = np.median(np.abs(robot_mm - np.median(robot_mm, axis=0)), axis=0)
    names = [capture.marker_names[i] for i in known]
    return list(_exchanged_pairs(names, differences * size_mm, robot_mm)) or _swapped_lips(capture)


def _swapped_lips(capture: Capture) -> list[Swap]:
    """Return inner-lip pairs with exchanged names: they come nearer as the outer lips part."""
    found: list[Swap] = []
    if _OUTER_LIPS[0] not in capture.marker_names or _OUTER_LIPS[1] not in capture.marker_names:
        return found
    pair = [capture.marker_names.index(name) for name in (_OUTER_LIPS[0], _OUTER_LIPS[1])]
    # Heights of the upper above the lower dot: outer lips, then inner lips.
    outer_mm = capture.markers_mm[:, pair[0], 1] - capture.markers_mm[:, pair[1], 1]
    for upper, lower in _INNER_LIPS:
        if upper in capture.marker_names and lower in capture.marker_names:
            pair = [capture.marker_names.index(name) for name in (upper, lower)]
            inner_mm = capture.markers_mm[:, pair[0], 1] - capture.markers_mm[:, pair[1], 1]
            known = np.isfinite(inner_mm) & np.isfinite(outer_mm)
            if known.sum() > 2 and np.corrcoef(inner_mm[known], outer_mm[known])[0, 1] < _OPPOSED:
                found.append(Swap(upper, lower))
    return found


def swapped_in_poses(capture: Capture, expected_mm: Array) -> list[Swap]:
    """Return the pairs of markers whose names were exchanged in single poses.

    Parameters
    ----------
    capture : Capture
        Capture of n poses.
    expected_mm : Array | None
        (n, n_markers, 3) mm, expected markers; None: by fitted lines.

    Returns
    -------
    list[Swap]
        Pairs, each with its pose.
    """
    names, found = capture.marker_names, []
    for pose, (seen_mm, wanted_mm) in enumerate(zip(capture.markers_mm, expected_mm, strict=True)):
        filled_mm = np.where(np.isfinite(seen_mm), seen_mm, wanted_mm)
        pairs = _exchanged_pairs(names, filled_mm - wanted_mm, filled_mm, pose, near_mm=_SWAP_MM)
        found += list(pairs)
    return found


def _exchanged_pairs(
    names: Sequence[str],
    off_mm: Array,
    points_mm: Array,
    pose: int | None = None,
    *,
    near_mm: float = np.inf,
) -> Iterator[Swap]:
    """Yield pairs of exchanged markers, the clearest first; a marker is in one pair at most.

    off_mm: (n, 3), each marker's offset from its expected position; points_mm: (n, 3), its
    position; pose: the number stored in the swaps, None: in every pose; near_mm: how near each
    marker must be to the other's expected position.
    """
    error_mm = np.linalg.norm(off_mm, axis=1)
    pairs = []
    for a, b in combinations(np.flatnonzero(error_mm > _SWAP_MM).tolist(), 2):
        # Errors of the two as they are named, then with their names exchanged; sums of squares.
        named_mm2 = error_mm[a] ** 2 + error_mm[b] ** 2
        between_mm = points_mm[b] - points_mm[a]
        a_mm = np.linalg.norm(off_mm[a] + between_mm)
        b_mm = np.linalg.norm(off_mm[b] - between_mm)
        swapped_mm2 = a_mm**2 + b_mm**2
        # Two wild readings in one pose are no exchange: each must come near the other's expected
        # place.
        both = a_mm < 0.6 * error_mm[b] and b_mm < 0.6 * error_mm[a] and max(a_mm, b_mm) < near_mm
        if both and swapped_mm2 < (1.0 - _SWAP_SHARE) * named_mm2:
            pairs.append((swapped_mm2 / named_mm2, a, b))
    used: set[int] = set()
    for _, a, b in sorted(pairs):
        if not used & {a, b}:
            used |= {a, b}
            yield Swap(names[a], names[b], pose)


#: Readings that must agree before names are exchanged.
_N_LOOKS = 3


def retake_swaps(
    plan: PosePlan,
    marker_names: tuple[str, ...],
    robot: Robot,
    poses: list[CapturedPose],
    kept: KeptPoses = NOT_KEPT,
    report: Callable[[str], None] = lambda _: None,
    expected_mm: Array | None = None,
) -> list[CapturedPose]:
    """Return the poses, those with two exchanged marker names captured again and reported.

    Where all three readings of a pose agree, the names are exchanged back.

    Parameters
    ----------
    plan,marker_names,robot : PosePlan
        The capture's plan, its markers' names, and the robot to move.
    poses : list[CapturedPose]
        All captured poses.
    kept : KeptPoses
        File to which the corrected poses are added.
    report : Callable[[str], None]
        Called with a line for each such pose.
    expected_mm : Array | None
        (n, n_markers, 3) mm, expected in the plan; None: by lines through the poses.

    Returns
    -------
    list[CapturedPose]
        The poses, in their order.
    """
    seen = gather(plan, marker_names, poses)
    if not len(seen):
        return poses
    rows = seen.rows
    if expected_mm is None:
        usual_mm = straight_lines(seen).expected_mm
    else:  # a tracker may stand askew
        usual_mm = turned_like(expected_mm[list(rows)], seen.markers_mm)
    found = swapped_in_poses(seen, usual_mm)
    pose_of_row = {pose.index: pose for pose in poses}
    for row in sorted({swap.pose for swap in found if swap.pose is not None}):
        index, names = rows[row], [swap.names for swap in found if swap.pose == row]
        pairs = " and ".join(f"{one!r} with {other!r}" for one, other in names)
        for _ in range(_N_LOOKS - 1):
            pose = take_pose(plan, index, robot)
            # A capture of this reading alone, to look for exchanged names in it.
            one = replace(
                seen,
                goals_deg=plan.goals_deg[[index]],
                from_below=plan.from_below[[index]],
                markers_mm=pose.markers_mm[None],
            )
            swaps = swapped_in_poses(one, usual_mm[[row]])
            if [swap.names for swap in swaps] != names:
                report(f"pose {index + 1}: the tracker exchanged {pairs}: taken again")
                break
        else:
            pose = replace(pose, markers_mm=exchanged(one, swaps)[0])
            report(f"pose {index + 1}: the tracker exchanged {pairs} {_N_LOOKS} times: named anew")
        pose_of_row[index] = pose
        kept.add(pose, plan, marker_names)
    if found:
        robot.move(np.zeros(len(plan.servo_names)))
    return list(pose_of_row.values())
