"""What changed on a face between a pose and a later repetition of that pose.

A face in an equal pose, reached from an equal side, has equal markers, however crooked its skin is:
nothing has to be learnt first. The first part of a plan, neutral and every joint alone, is taken
again at the end. A common shift of all these poses along one joint's motion is a horn that slipped;
where a joint alone moves the face less than before, it stopped, or its rod is torn. Of several
suspicions the one counts that explains most of the change.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.capture.capture import Capture, PosePlan, plan_rows
from calibration.capture.joint_health import JointFault
from calibration.capture.straight_lines import StraightLines
from lipsync.arrays import Array

#: Degrees, and the share of what a joint did, from which a change is a fault. Zeros that drift with
#: warm servos come to two degrees and noise to a quarter; slipped splines begin at ten.
_SLIPPED_DEG, _LOST_SHARE, _ALL_LOST = 5.0, 0.45, 0.8
#: A joint that would have to have slipped by more than a quarter of a turn is not to blame.
_MOST_SLIPPED_DEG = 90.0
#: So many standard errors of noise, whatever else: for a slip, which all poses show, and for what a
#: joint does alone, where healthy robots come to 2.3. And of a marker that nothing explains.
_SURE_ERRORS, _SURE_LOST_ERRORS, _SURE_MM = 6.0, 3.5, 1.5
_MOTION_ERRORS = 3.0
#: What a joint does must be alike what changed by so much, to be blamed for it.
_LEAST_COSINE = 0.7
#: Another joint this near to 0 does not move; two goals this near are the same.
_STILL_DEG, _SAME_DEG = 0.1, 0.01
#: Poses between which so much of a capture lies are early and late.
_LATER_SHARE = 0.3


@dataclass(frozen=True, slots=True)
class FaceChange:
    """A change of the face: `slipped` by degrees, `stopped` by a share, or `shifted` by mm.

    joint: its number, -1 for `shifted`. first, last: poses between which it happened, counted from
    1.
    """

    kind: str
    joint: int
    by: float
    first: int
    last: int

    def description(self, names: tuple[str, ...]) -> str:
        """Return the change in one line, with the remedy; `names` are those of the servos."""
        where = f"between poses {self.first} and {self.last}"
        if self.joint < 0:
            return (
                f"the face is another one than before, by {self.by:.1f} mm, {where}: was the "
                "tracker or a part moved, did the skin tear? Look for it and capture again"
            )
        name = names[self.joint]
        if self.kind == "slipped":
            return (
                f"servo {name!r} slipped on its shaft by about {abs(self.by):.0f} deg {where}; "
                "check its horn, and capture again"
            )
        return (
            f"servo {name!r} stopped moving {self.by:.0%} of what it moved, {where}; check its "
            "horn, its rod, the skin there and its torque, and capture again"
        )


def poses_to_repeat(plan: PosePlan) -> PosePlan:
    """Return a plan's poses to repeat: neutral and every joint alone, once from each side."""
    rows = np.flatnonzero((np.abs(plan.goals_deg) > _STILL_DEG).sum(axis=1) <= 1)
    keys = np.hstack([plan.goals_deg[rows], plan.from_below[rows]])
    first = np.unique(keys, axis=0, return_index=True)[1]
    return plan_rows(plan, rows[np.sort(first)].tolist())


def repeats(capture: Capture) -> list[tuple[int, int]]:
    """Return the first and the last row of each pose that was captured early and again late.

    The two are over 0.3 of the number of poses apart.
    """
    keys = np.hstack([np.rint(capture.goals_deg / _SAME_DEG), capture.from_below])
    # Captured poses with equal goals and sides get one number.
    pose_numbers = np.unique(keys, axis=0, return_inverse=True)[1].ravel()
    early_and_late = []
    for pose in np.unique(pose_numbers):
        rows = np.flatnonzero(pose_numbers == pose)
        if rows[-1] - rows[0] > _LATER_SHARE * len(capture):
            early_and_late.append((int(rows[0]), int(rows[-1])))
    return sorted(early_and_late)


def is_repeated(capture: Capture) -> bool:
    """Return whether neutral, and every joint moved alone, were captured both early and late."""
    moved = np.abs(capture.goals_deg[[early for early, _ in repeats(capture)]]) > _STILL_DEG
    return bool((~moved).all(axis=1).any() and moved[moved.sum(axis=1) == 1].any(axis=0).all())


@dataclass(frozen=True, slots=True)
class ChangedPoses:
    """Measures of change between early and late captures of poses; arrays are (n_servos,).

    did_mm: how far each joint, alone, moved the face along its usual direction, early; does_mm: the
    same, late; lost_error_mm: standard error of their difference; turned_deg: the joint's angle in
    these poses. slid_mm: the shift common to all poses, along that direction; slid_error_mm: its
    standard error; alike: the cosine between common shift and direction, without the noise.
    common_mm: (n_markers, 3), the common shift, late less early; noise_mm: standard deviation of
    one pose's shift about it. n: number of repeated poses; first, last: the change happened between
    these poses, counted from 1.
    """

    did_mm: Array
    does_mm: Array
    lost_error_mm: Array
    turned_deg: Array
    slid_mm: Array
    slid_error_mm: Array
    alike: Array
    common_mm: Array
    noise_mm: float
    n: int
    first: int
    last: int

    @property
    def lost(self) -> Array:
        """The share of each joint's early motion that is missing late.

        Returns
        -------
        Array
            (n_joints,): 0 none, 1 all.
        """
        return np.asarray(1.0 - self.does_mm / self.did_mm)

    @property
    def slipped_deg(self) -> Array:
        """How far each horn would have slipped if it alone caused the common shift.

        Returns
        -------
        Array
            (n_joints,) degrees.
        """
        return np.asarray(self.slid_mm / self.did_mm * self.turned_deg)

    @property
    def common_error_mm(self) -> float:
        """The standard error of common_mm, in mm: that of a median over n poses."""
        return 1.25 * self.noise_mm / math.sqrt(self.n)


def changed_poses(capture: Capture, lines: StraightLines) -> ChangedPoses | None:
    """Return the changes over repeated poses, or None.

    None unless neutral, and every joint moved alone, were captured both early and late. lines: the
    fitted lines of this capture.
    """
    if not is_repeated(capture):
        return None
    pairs = repeats(capture)
    # Rows of the capture: the first and the last reading of each repeated pose.
    early, late = (np.array([pair[i] for pair in pairs]) for i in (0, 1))
    goals_deg = capture.goals_deg[early]
    is_moved = np.abs(goals_deg) > _STILL_DEG
    neutral = np.flatnonzero(~is_moved.any(axis=1))
    rows_alone = [_farthest_alone(is_moved, goals_deg, joint) for joint in range(is_moved.shape[1])]
    turned_deg = np.array([goals_deg[rows[0], joint] for joint, rows in enumerate(rows_alone)])
    seen_mm = np.where(lines.far[..., None], np.nan, capture.markers_mm)
    off_mm = _zero_where_lost(seen_mm[late] - seen_mm[early])
    common_mm = np.median(off_mm, axis=0)
    # Most markers in most poses are where they were: what is left of them is noise. 1.4826 times a
    # median deviation estimates a standard deviation, and the standard error of a median is 1.25
    # times that of a mean.
    noise_mm = max(1.4826 * float(np.median(np.abs(off_mm - common_mm))), 1e-6)
    n = len(pairs)
    # The direction in which each joint, turned as in these poses, moves all markers: a unit vector
    # from the fitted lines, which know it better than two readings do.
    headings = lines.slopes_mm * np.sign(turned_deg)[:, None, None]
    headings = headings / np.maximum(np.linalg.norm(headings, axis=(1, 2), keepdims=True), 1e-9)

    def alone_mm(readings: NDArray[np.int64]) -> Array:
        # The motion from neutral along that direction, (n_servos,), in the early or late readings.
        still_mm = _mean_seen_mm(seen_mm[readings[neutral]])
        moved_mm = np.array([_mean_seen_mm(seen_mm[readings[rows]]) for rows in rows_alone])
        return np.asarray(np.sum(headings * _zero_where_lost(moved_mm - still_mm), axis=(1, 2)))

    did_mm, does_mm = alone_mm(early), alone_mm(late)
    # Of a difference of two means, in units of the noise's variance.
    variances = np.array([1.0 / len(rows) + 1.0 / len(neutral) for rows in rows_alone])
    slid_mm = np.sum(headings * common_mm, axis=(1, 2))
    error_mm2 = common_mm.size * (1.25 * noise_mm) ** 2 / n
    # The scatter of whole poses along each direction, without the poses in which the joint itself
    # moves: markers counted from a noisy nose are off together.
    along_mm = np.einsum("smk,nmk->sn", headings, off_mm)
    others_mm = np.where(is_moved.T, np.nan, along_mm)
    spread_mm = np.nanmedian(np.abs(others_mm - np.nanmedian(others_mm, axis=1)[:, None]), axis=1)
    along_noise_mm = np.maximum(noise_mm, 1.4826 * spread_mm)
    # The length of the common shift, without what noise adds to it.
    common_size_mm = math.sqrt(max(float(np.sum(common_mm**2)) - error_mm2, error_mm2 / n))
    return ChangedPoses(
        did_mm=np.maximum(did_mm, 1e-6),
        does_mm=does_mm,
        lost_error_mm=along_noise_mm * np.sqrt(variances),
        slid_error_mm=1.25 * along_noise_mm / math.sqrt(n),
        turned_deg=turned_deg,
        slid_mm=slid_mm,
        alike=np.abs(slid_mm) / common_size_mm,
        common_mm=common_mm,
        noise_mm=noise_mm,
        n=n,
        first=int(early.max()) + 1,
        last=int(late.min()) + 1,
    )


def _farthest_alone(moved: NDArray[np.bool_], goals_deg: Array, joint: int) -> NDArray[np.int64]:
    """Return the rows in which `joint` is at its largest angle and all others are at 0.

    moved: (n, n_servos), which joints of `goals_deg` are off 0.
    """
    rows = np.flatnonzero(moved[:, joint] & (moved.sum(axis=1) == 1))
    most_deg = goals_deg[rows[np.abs(goals_deg[rows, joint]).argmax()], joint]
    return np.asarray(rows[np.abs(goals_deg[rows, joint] - most_deg) < _STILL_DEG])


def _mean_seen_mm(seen_mm: Array) -> Array:
    """Return the mean of seen_mm, (n, n_markers, 3), over its n poses; NaN where never seen."""
    return np.asarray(np.ma.filled(np.ma.masked_invalid(seen_mm).mean(axis=0), np.nan))


def confirms(changed: ChangedPoses, fault: JointFault) -> bool:
    """Return whether repeated poses, `changed`, confirm a fault that `joint_fault` has found."""
    if fault.joint < 0:
        return False
    if fault.kind == "slipped":
        return bool(abs(changed.slipped_deg[fault.joint]) > _SLIPPED_DEG)
    return bool(changed.lost[fault.joint] > _LOST_SHARE)


def face_change(changed: ChangedPoses) -> FaceChange | None:
    """Return the one change of the face that explains most of the differences in `changed`.

    None if no change is beyond doubt. Joints that stopped or slipped come before a shift of the
    whole face.
    """
    where = changed.first, changed.last
    slip_errors = np.abs(changed.slid_mm) / changed.slid_error_mm
    lost_mm = changed.did_mm - changed.does_mm
    lost_errors = lost_mm / changed.lost_error_mm
    candidates = []
    for joint, (slip_deg, lost) in enumerate(zip(changed.slipped_deg, changed.lost, strict=True)):
        slip_in_errors, loss_in_errors = float(slip_errors[joint]), float(lost_errors[joint])
        is_stop = lost > _LOST_SHARE and loss_in_errors > _SURE_LOST_ERRORS
        if is_stop:
            fault = FaceChange("stopped", joint, min(float(lost), 1.0), *where)
            candidates.append((lost_mm[joint], fault))
        # A joint that stopped far from 0 shifts all poses, too; a horn that slipped still moves.
        may_slip = not is_stop or lost < _ALL_LOST
        # Nor is a joint to blame whose motion alone, early, was no more than noise.
        moved_visibly = changed.did_mm[joint] > _MOTION_ERRORS * changed.lost_error_mm[joint]
        fits_direction = moved_visibly and changed.alike[joint] > _LEAST_COSINE
        is_slip = _SLIPPED_DEG < abs(slip_deg) < _MOST_SLIPPED_DEG
        if may_slip and fits_direction and is_slip and slip_in_errors > _SURE_ERRORS:
            fault = FaceChange("slipped", joint, float(slip_deg), *where)
            candidates.append((abs(changed.slid_mm[joint]) * math.sqrt(changed.n), fault))
    if candidates:
        return max(candidates, key=lambda each: float(each[0]))[1]
    most_mm = float(np.sort(np.linalg.norm(changed.common_mm, axis=1))[-3:].mean())
    if most_mm > max(_SURE_MM, _SURE_ERRORS * changed.common_error_mm):
        return FaceChange("shifted", -1, most_mm, *where)
    return None


def _zero_where_lost(off_mm: Array) -> Array:
    """Return `off_mm`, late less early markers, with 0 where a point was lost."""
    seen: NDArray[np.bool_] = np.isfinite(off_mm)
    return np.where(seen, off_mm, 0.0)
