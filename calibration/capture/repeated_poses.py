"""What changed on a face between a pose and the same pose later: horns, rods, all of it.

A face that is asked for the same pose, from the same side, looks the same, however crooked its skin
is: nothing has to be learnt first. The first part of a plan, neutral and every joint alone, is
taken again at the end. What all of these poses are off by alike, and along what one joint does, is
a horn that slipped; where a joint alone does less than it did, it stopped, or its rod is torn. Of
several suspicions the one counts that explains most of what changed.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.capture.capture import Capture, PosePlan, plan_rows
from lipsync.arrays import Array

#: Degrees, and the share of what a joint did, from which a change is a fault. Zeros that drift with
#: warm servos come to two degrees and noise to a quarter; slipped splines begin at ten.
_SLIPPED_DEG, _LOST_SHARE = 5.0, 0.45
#: So many standard errors of noise, whatever else; and of a marker that nothing explains.
_SURE_ERRORS, _SURE_MM = 6.0, 1.5
#: What a joint does must be alike what changed by so much, to be blamed for it.
_ALIKE = 0.7
#: Another joint this near to 0 does not move; two goals this near are the same.
_STILL_DEG, _SAME_DEG = 0.1, 0.01
#: Poses between which so much of a capture lies are early and late.
_APART = 0.3


@dataclass(frozen=True, slots=True)
class FaceChange:
    """kind: `slipped` by degrees, `stopped` by a share, or `shifted` (joint -1) by millimetres.

    first, last: poses between which it happened, counted from 1. errors: by how many standard
    errors of noise.
    """

    kind: str
    joint: int
    by: float
    errors: float
    first: int
    last: int

    def told(self, names: tuple[str, ...]) -> str:
        """One line, with what to do."""
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


def first_part(plan: PosePlan) -> PosePlan:
    """Neutral and every joint alone, from below: the poses of a plan that are taken again."""
    alone = (np.abs(plan.goals_deg) > _STILL_DEG).sum(axis=1) <= 1
    rows = np.flatnonzero(alone & (plan.from_below > 0.0).all(axis=1))
    first = np.unique(plan.goals_deg[rows], axis=0, return_index=True)[1]
    return plan_rows(plan, rows[np.sort(first)].tolist())


def repeats(capture: Capture) -> list[tuple[int, int]]:
    """Rows of the first and the last time that a pose was taken, where much lies between."""
    keys = np.hstack([np.rint(capture.goals_deg / _SAME_DEG), capture.from_below])
    alike = np.unique(keys, axis=0, return_inverse=True)[1].ravel()
    pairs = []
    for pose in np.unique(alike):
        rows = np.flatnonzero(alike == pose)
        if rows[-1] - rows[0] > _APART * len(capture):
            pairs.append((int(rows[0]), int(rows[-1])))
    return sorted(pairs)


def is_repeated(capture: Capture) -> bool:
    """Whether every joint was seen alone early and late."""
    goals_deg = capture.goals_deg[[early for early, _ in repeats(capture)]]
    return bool(len(goals_deg)) and bool((np.abs(goals_deg) > _STILL_DEG).any(axis=0).all())


@dataclass(frozen=True, slots=True)
class ChangedPoses:
    """What repeated poses say. does_mm: (n_servos, n_values), what each joint did alone, early.

    turned_deg: (n_servos,), by so much; own_mm: (n_servos, n_values), by what it did less or more
    later; common_mm: (n_values,), what all poses are off by; noise_mm: of each difference. n: so
    many poses were repeated, between rows.
    """

    does_mm: Array
    turned_deg: Array
    own_mm: Array
    common_mm: Array
    noise_mm: float
    n: int
    rows: tuple[int, int]

    @property
    def lost(self) -> Array:
        """(n_servos,): the share of what each joint did that it does no more."""
        return np.asarray(-np.sum(self.own_mm * self.does_mm, axis=1) / self.sizes_mm**2)

    @property
    def slipped_deg(self) -> Array:
        """(n_servos,): how far each horn would have slipped, were it alone to blame."""
        along_mm = self.does_mm @ self.common_mm / self.sizes_mm**2
        return np.asarray(along_mm * self.turned_deg)

    @property
    def sizes_mm(self) -> Array:
        """(n_servos,): how far each joint moved all markers together."""
        return np.maximum(np.linalg.norm(self.does_mm, axis=1), 1e-9)

    @property
    def alike(self) -> Array:
        """(n_servos,): cosine between what changed and what each joint does."""
        size_mm = max(float(np.linalg.norm(self.common_mm)), 1e-9)
        return np.asarray(np.abs(self.does_mm @ self.common_mm) / (self.sizes_mm * size_mm))


def changed_poses(capture: Capture) -> ChangedPoses | None:
    """None where not every joint was seen alone twice."""
    if not is_repeated(capture):
        return None
    pairs = repeats(capture)
    early, late = (np.array([pair[i] for pair in pairs]) for i in (0, 1))
    goals_deg = capture.goals_deg[early]
    off_mm = _filled(capture.markers_mm[late] - capture.markers_mm[early])
    moved = np.abs(goals_deg) > _STILL_DEG
    neutral_mm = np.nanmean(capture.markers_mm[early[~moved.any(axis=1)]], axis=0)
    alone: list[int] = []
    for joint in range(goals_deg.shape[1]):
        rows = np.flatnonzero(moved[:, joint] & (moved.sum(axis=1) == 1))
        alone.append(int(rows[np.abs(goals_deg[rows, joint]).argmax()]))
    common_mm = np.median(off_mm, axis=0)
    does_mm = _filled(capture.markers_mm[early[alone]] - neutral_mm)
    own_mm = off_mm[alone] - common_mm
    # Most markers in most poses are where they were: what is left of them is noise.
    noise_mm = 1.4826 * float(np.median(np.abs(off_mm - common_mm)))
    return ChangedPoses(
        does_mm=does_mm.reshape(len(alone), -1),
        turned_deg=goals_deg[alone, np.arange(len(alone))],
        own_mm=own_mm.reshape(len(alone), -1),
        common_mm=common_mm.reshape(-1),
        noise_mm=max(noise_mm, 1e-6),
        n=len(pairs),
        rows=(int(early.max()) + 1, int(late.min()) + 1),
    )


def face_change(changed: ChangedPoses) -> FaceChange | None:
    """The one thing that changed and explains most of it, beyond doubt; None where nothing did."""
    n, sizes_mm, first_last = changed.n, changed.sizes_mm, changed.rows
    common_error_mm = 1.25 * changed.noise_mm / np.sqrt(n)
    slip_errors = np.abs(changed.slipped_deg / changed.turned_deg) * sizes_mm / common_error_mm
    lost_errors = changed.lost * sizes_mm / changed.noise_mm
    common_size_mm = float(np.linalg.norm(changed.common_mm)) * np.sqrt(n)
    found = []
    for joint in range(len(sizes_mm)):
        slip_deg, lost = float(changed.slipped_deg[joint]), float(changed.lost[joint])
        alike, errors = float(changed.alike[joint]), float(slip_errors[joint])
        if abs(slip_deg) > _SLIPPED_DEG and errors > _SURE_ERRORS and alike > _ALIKE:
            fault = FaceChange("slipped", joint, slip_deg, errors, *first_last)
            found.append((alike * common_size_mm, fault))
        if lost > _LOST_SHARE and lost_errors[joint] > _SURE_ERRORS:
            errors = float(lost_errors[joint])
            fault = FaceChange("stopped", joint, min(lost, 1.0), errors, *first_last)
            found.append((lost * sizes_mm[joint], fault))
    if found:
        return max(found, key=lambda each: float(each[0]))[1]
    by_marker_mm = np.linalg.norm(changed.common_mm.reshape(-1, 3), axis=1)
    most_mm = float(np.sort(by_marker_mm)[-3:].mean())
    if most_mm > max(_SURE_MM, _SURE_ERRORS * common_error_mm):
        return FaceChange("shifted", -1, most_mm, most_mm / common_error_mm, *first_last)
    return None


def _filled(off_mm: Array) -> Array:
    """Points that one of the two did not see changed by nothing."""
    seen: NDArray[np.bool_] = np.isfinite(off_mm)
    return np.where(seen, off_mm, 0.0)
