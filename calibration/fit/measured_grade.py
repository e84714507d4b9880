"""The grade of a calibration, measured on the robot in poses of speech left out of the fit.

The learnt face cannot show its own errors. So the robot moves to the poses that the map gives for
frames that were left out, is measured there, and compared with the wanted shapes; the tracker's own
noise is subtracted. Only the poses and the expected markers are needed, so the robot can be
measured again weeks later: a check plan is their file, with the columns of a plan, so that any
program that moves a robot through a plan can use it; then, of each pose, the viseme class, the
speaker's gap, the share of speech that it represents, the wanted opening, the robot's own closed
gap and the tracker's noise; the map's checksum; and the wanted position of each marker,
`<marker>_x_mm`, `_y_mm`, `_z_mm`.
Loads scikit-learn; the live path never does.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from sklearn.cluster import KMeans

from calibration.calibration import Calibration, CalibrationError
from calibration.capture.attitude import turned_like
from calibration.capture.capture import Capture, PosePlan, plan_around
from calibration.capture.marker_files import (
    csv_rows,
    number_in,
    plan_table,
    read_plan,
    write_table,
)
from calibration.capture.straight_lines import on_head, outlier_line
from calibration.closure import CLOSED_GAP_MM
from calibration.fit.measured import MeasuredFit, lips_apart_mm
from calibration.fit.retargeting import correspond, gap_heights_mm
from calibration.grade import Grade, gap_figures, is_slightly_open
from calibration.mouth_servos import MouthServos
from lipsync.animpho.units import SAMPLES_PER_ANIMPHO, AnimPhoUnits, FaceWithAnimPhos
from lipsync.arrays import Array
from lipsync.phonemes import PHONEMES, VISEME_CLASSES, VISEME_OF

N_GRADED = 10
#: Of these with closed lips, and with lips a little open, as far as speech has them.
_N_CLOSED, _N_SMALL = 3, 2
#: A grade worse than one of these is refused: lips off by a third of what they move in speech, or
#: openings of which less than half is left.
_WORST_LIPS_MM, _WORST_SLOPE = 2.0, 0.5
#: Closed lips may be so far apart by what the tracker sees of them.
_TOUCH_MM = 1.0
#: A reading this far from where it should be, and so many times as far as its pose's other lips,
#: is none.
_FAR_MM, _FAR_TIMES = 8.0, 5.0
_CLOSED_UNSEEN = (
    "no closed pose shows dots of both lips: how far closed lips stay apart is estimated, not "
    "measured"
)


@dataclass(frozen=True, slots=True)
class GradedPoses:
    """Poses by which a map is graded, for speech left out of its fit, and the wanted markers.

    targets_mm: (n, n_markers, 3); wanted_open_mm: (n,), beyond the robot's own closed gap
    own_gap_mm; visemes: the first phoneme of each pose's class; human_gap_mm: (n,), the speaker's;
    shares: (n,), of the speech that each represents, 1 in all; expected_mm: (n,), distance of the
    lips from the targets by the learnt face; noise_mm: of the tracker.
    """

    plan: PosePlan
    marker_names: tuple[str, ...]
    targets_mm: Array
    wanted_open_mm: Array
    visemes: tuple[str, ...]
    human_gap_mm: Array
    shares: Array
    expected_mm: Array
    own_gap_mm: float
    noise_mm: float

    def __len__(self) -> int:
        return len(self.targets_mm)


def graded_poses(fit: MeasuredFit, servos: MouthServos, seed: int = 0) -> GradedPoses:
    """Return ten poses of held-out speech, by which a fit is graded.

    The poses' goals lead by half the backlash, so that the horns reach the poses. servos: with
    ranges and rules; seed: of the choice of poses and of the side that each joint comes from.
    """
    rows, shares = _choose_frames(fit, seed)
    frames = fit.held_out[rows]
    positions_deg = np.array([fit.calibration.positions_deg(frame) for frame in frames])
    plan = plan_around(positions_deg, servos.joints, rules=servos.rules, seed=seed + 1)
    # Goals half the backlash beyond the pose, in the direction of the last step.
    goals_deg = positions_deg + plan.from_below * fit.face.backlash_deg / 2
    model, retargeting = fit.retargeting.model, fit.retargeting
    assert isinstance(model, FaceWithAnimPhos)  # what was fitted has them
    from_rest = frames - model.rest
    targets_mm = retargeting.targets_mm(from_rest)
    lips = list(fit.names.shape_features.lips)
    return GradedPoses(
        plan=replace(plan, goals_deg=np.clip(goals_deg, *servos.limits_deg)),
        marker_names=fit.names.marker_names,
        targets_mm=targets_mm,
        wanted_open_mm=retargeting.wanted_open_mm(from_rest).mean(axis=1),
        visemes=tuple(_viseme_of(model.animphos, frame) for frame in frames),
        human_gap_mm=model.lip_gaps_mm(model.markers_mm(frames)),
        shares=shares,
        expected_mm=lips_apart_mm(retargeting.mouth.seen_mm(positions_deg), targets_mm, lips),
        own_gap_mm=float(retargeting.closed_mm.mean()),
        noise_mm=fit.face.noise_mm,
    )


def graded(
    calibration: Calibration, poses: GradedPoses, seen: Capture
) -> tuple[Calibration, tuple[str, ...]]:
    """Return the calibration with a grade by the capture of graded poses, and warnings.

    Parameters
    ----------
    calibration : Calibration
        Calibration to be graded.
    poses : GradedPoses
        The planned poses and wanted markers.
    seen : Capture
        Capture of some of the poses, in the rows that it names.

    Returns
    -------
    tuple[Calibration, tuple[str, ...]]
        With grade and measured coverage in mm, and warnings for the user.

    Raises
    ------
    CalibrationError
        Lips were captured in fewer than half of the poses, or never both.
    """
    rows = np.array(seen.rows, dtype=np.int64)
    if len(seen) < len(poses) // 2:
        raise CalibrationError(
            f"only {len(seen)} of {len(poses)} poses to grade by were captured; capture them all"
        )
    targets_mm, human_mm = poses.targets_mm[rows], poses.human_gap_mm[rows]
    shares = poses.shares[rows] / poses.shares[rows].sum()
    features = correspond(poses.marker_names).shape_features
    seen_mm = turned_like(seen.markers_mm, targets_mm)  # as the fit's readings were
    seen_mm, moved = on_head(seen_mm, targets_mm, poses.marker_names)
    remarks = ("the tracker was moved since the fit: markers are counted from the nose",) * moved
    seen_mm, left_out = _drop_far_lips(seen_mm, targets_mm, list(features.lips), poses.marker_names)
    remarks += left_out
    lips_mm2 = np.sum((seen_mm - targets_mm)[:, list(features.lips)] ** 2, axis=2)
    lips_seen = np.isfinite(lips_mm2).any(axis=1)
    if lips_seen.sum() < len(poses) // 2:
        raise CalibrationError("lips were seen in too few poses to grade by; capture them again")
    # Mean square distance of each pose's lips, without the tracker's noise in three axes.
    each_mm2 = np.full(len(lips_mm2), np.nan)
    each_mm2[lips_seen] = np.nanmean(lips_mm2[lips_seen], axis=1) - 3 * poses.noise_mm**2
    target_gaps_mm = gap_heights_mm(targets_mm, features.gaps)
    target_open_mm = target_gaps_mm.mean(axis=1) - poses.own_gap_mm
    # By the gaps that are seen: closed lips may hide dots.
    beyond_mm = np.ma.masked_invalid(gap_heights_mm(seen_mm, features.gaps) - target_gaps_mm)
    open_mm = target_open_mm + np.ma.filled(beyond_mm.mean(axis=1), np.nan)
    if not np.isfinite(open_mm).any():
        raise CalibrationError("no pose shows dots of both lips; capture them again")
    gaps = gap_figures(poses.wanted_open_mm[rows], open_mm, human_mm, shares)
    is_closed = (human_mm <= CLOSED_GAP_MM) & np.isfinite(open_mm)
    apart_mm = 0.0 if calibration.closing is None else calibration.closing.apart_mm
    closed_gap_mm = calibration.errors.closed_gap_mm
    if is_closed.any():
        closed_gap_mm = apart_mm + float(np.mean(open_mm[is_closed]))
    elif (poses.human_gap_mm <= CLOSED_GAP_MM).any():
        remarks += (_CLOSED_UNSEEN,)
    # Ten poses are few. So the error is that of the map over all held-out frames, by the learnt
    # face, plus what the poses show beyond the learnt face's prediction for them (the difference
    # estimator: Cochran, Sampling Techniques, 1977, 9.2A).
    beyond_mm2 = each_mm2 - poses.expected_mm[rows] ** 2
    grade = Grade(
        n_poses=len(seen),
        lip_rms_mm=_weighted_rms(calibration.errors.lip_rms_mm**2 + beyond_mm2, shares),
        gap_rms_mm=_weighted_rms((open_mm - target_open_mm) ** 2, shares),
        closed_gap_mm=closed_gap_mm,
        gap_slope=0.0 if gaps.slope is None else gaps.slope,
        small_gaps_kept=gaps.small_kept,
    )
    visemes = np.array(poses.visemes)[rows]
    coverage = dict(calibration.coverage)
    for viseme in sorted(set(visemes) & set(coverage)):
        chosen = (visemes == viseme) & lips_seen
        coverage[viseme] = replace(
            coverage[viseme],
            n_measured=int(chosen.sum()),
            measured_mm=_weighted_rms(each_mm2[chosen], shares[chosen]) if chosen.any() else None,
        )
    return replace(calibration, grade=grade, coverage=coverage), remarks


def too_bad(calibration: Calibration) -> str | None:
    """Return why a calibration is too bad to be used, by its grade or else by its estimated errors.

    None for a usable one, and for one with neither.
    """
    grade, errors, closing = calibration.grade, calibration.errors, calibration.closing
    if grade is not None:
        lips_mm, slope, closed_mm = grade.lip_rms_mm, grade.gap_slope, grade.closed_gap_mm
        how = ""
    elif calibration.origin.method == "measured" and errors.gap_slope is not None:
        lips_mm, slope, closed_mm = errors.lip_rms_mm, errors.gap_slope, errors.closed_gap_mm
        how = " (estimated)"
    else:
        return None
    if lips_mm > _WORST_LIPS_MM:
        return f"the lips are {lips_mm:.1f} mm from where they should be{how}"
    if slope < _WORST_SLOPE:
        return f"only {max(slope, 0.0):.0%} of an opening is made{how}"
    if closed_mm > _TOUCH_MM and closing is not None and not closing.closes:
        return f"the mouth {closing.description}"
    return f"closed lips stay {closed_mm:.1f} mm apart{how}" if closed_mm > _TOUCH_MM else None


def _choose_frames(fit: MeasuredFit, seed: int) -> tuple[NDArray[np.int64], Array]:
    """Return rows of up to N_GRADED held-out frames, spread over speech, and the share of each.

    Speech is divided into parts of similar frames, whose shares add up to 1; from each part one
    frame is drawn by `seed`, because the frame in its middle would be easier than the others.
    """
    rng = np.random.default_rng([seed, 10])
    from_rest = fit.held_out - fit.retargeting.model.rest
    model = fit.retargeting.model
    is_closed = fit.retargeting.closing(from_rest) >= 1.0
    is_small_gap = ~is_closed & is_slightly_open(model.lip_gaps_mm(model.markers_mm(fit.held_out)))
    n_closed, n_small = min(_N_CLOSED, int(is_closed.sum())), min(_N_SMALL, int(is_small_gap.sum()))
    # Frames with closed lips, with lips a little open, and others that fill up to N_GRADED.
    kinds = ((is_closed, n_closed), (is_small_gap, n_small), (~is_closed & ~is_small_gap, N_GRADED))
    rows: list[int] = []
    counts: list[int] = []
    for mask, n in kinds:
        for part in _alike_parts(fit.held_out, np.flatnonzero(mask), min(n, N_GRADED - len(rows))):
            rows.append(int(rng.choice(part)))
            counts.append(len(part))
    return np.array(rows), np.array(counts) / sum(counts)


def _alike_parts(frames: Array, rows: NDArray[np.int64], n: int) -> list[NDArray[np.int64]]:
    """Return row numbers `rows` of `frames` in at most `n` parts of alike frames, by k-means."""
    if len(rows) <= n or n == 0:
        return [rows[i : i + 1] for i in range(min(n, len(rows)))]
    labels = KMeans(n, n_init=2, random_state=0).fit(frames[rows]).labels_
    return [rows[labels == label] for label in range(n) if (labels == label).any()]


def _viseme_of(animphos: AnimPhoUnits, frame: Array) -> str:
    """Return the first phoneme of the viseme class spoken in a frame, a row of `animphos.frames`.

    animphos: the recorded pieces of motion, each about one phoneme, joined in `frames`.
    """
    row = int(np.flatnonzero((animphos.frames == frame).all(axis=1))[0]) // SAMPLES_PER_ANIMPHO
    phoneme = next(p for i, p in enumerate(PHONEMES) if row in animphos.phoneme_table[i])
    return VISEME_CLASSES[VISEME_OF[phoneme]][0]


def _drop_far_lips(
    seen_mm: Array, targets_mm: Array, lips: Sequence[int], names: tuple[str, ...]
) -> tuple[Array, tuple[str, ...]]:
    """Return the markers with lip points far from their targets as NaN, and a report of how many.

    Far: by more than 8 mm, and more than 5 times the median distance of the pose's lip points.
    seen_mm, targets_mm: (n_poses, n_markers, 3). lips: indices of the lip markers; names: of all
    markers. The report is a tuple of one line for a person, or empty if no point is far.
    """
    far = np.zeros(seen_mm.shape[:2], dtype=bool)
    off_mm = np.linalg.norm((seen_mm - targets_mm)[:, lips], axis=2)
    for pose, lips_mm in enumerate(off_mm):
        known_mm = lips_mm[np.isfinite(lips_mm)]
        if len(known_mm):
            far[pose, lips] = lips_mm > max(_FAR_MM, _FAR_TIMES * float(np.median(known_mm)))
    return np.where(far[..., None], np.nan, seen_mm), outlier_line(far, names)


def _weighted_rms(squares: Array, shares: Array) -> float:
    """Return the root of the mean of finite squares, weighted by shares; 0 if that is negative."""
    known = np.isfinite(squares)
    return float(np.sqrt(max(np.average(squares[known], weights=shares[known]), 0.0)))


_AXES: Final = ("x_mm", "y_mm", "z_mm")
#: Columns of numbers, and the fields of `GradedPoses` that they hold.
_NUMBERS: Final = {
    "human_gap_mm": "human_gap_mm", "share": "shares", "asked_open_mm": "wanted_open_mm",
    "expected_mm": "expected_mm", "own_gap_mm": "own_gap_mm", "noise_mm": "noise_mm",
}  # fmt: skip
_VISEME, _MAP, _FIRST = "viseme", "map", "_x_mm"


def write_check_plan(poses: GradedPoses, calibration: Calibration, path: Path) -> None:
    """Write the poses to grade a calibration by, and the wanted markers, as a check plan (CSV).

    The file is written whole or not at all. Raises OutputError.
    """
    header, rows = plan_table(poses.plan)
    target_columns = [f"{name}_{axis}" for name in poses.marker_names for axis in _AXES]
    figures = [np.broadcast_to(getattr(poses, field), len(poses)) for field in _NUMBERS.values()]
    for i, row in enumerate(rows):
        row += [poses.visemes[i], *(f"{column[i]:.4f}" for column in figures)]
        row += [map_checksum(calibration), *(f"{mm:.3f}" for mm in poses.targets_mm[i].ravel())]
    write_table(path, [*header, _VISEME, *_NUMBERS, _MAP, *target_columns], rows)


def read_check_plan(path: Path, calibration: Calibration) -> GradedPoses:
    """Return the poses to grade a calibration by from a check plan, a CSV file.

    Raises CalibrationError for a plan of another map, or one without wanted markers.
    """
    plan = read_plan(path, calibration.servo_names)
    rows = list(csv_rows(path, ("pose",)))
    columns = rows[0][1] if rows else {}
    names = tuple(name.removesuffix(_FIRST) for name in columns if name.endswith(_FIRST))
    if _MAP not in columns or not names:
        raise CalibrationError(
            f"{path}: has no values to grade by; `lipservo calibrate fit --check-plan FILE` writes "
            "a plan with them"
        )
    needed = (_VISEME, *_NUMBERS, *(f"{name}_{axis}" for name in names for axis in _AXES))
    rows = list(csv_rows(path, needed))
    if {row[_MAP] for _, row in rows} != {map_checksum(calibration)}:
        raise CalibrationError(
            f"{path}: was written for another calibration; use the --check-plan of this fit"
        )

    def numbers(column: str) -> Array:
        return np.array([number_in(row[column], place) for place, row in rows])

    targets_mm = [[numbers(f"{name}_{axis}") for axis in _AXES] for name in names]
    figures: dict[str, Any] = {field: numbers(column) for column, field in _NUMBERS.items()}
    for single in ("own_gap_mm", "noise_mm"):
        figures[single] = float(figures[single][0])
    return GradedPoses(
        plan=plan,
        marker_names=names,
        targets_mm=np.array(targets_mm).transpose(2, 0, 1),
        visemes=tuple(str(row[_VISEME]) for _, row in rows),
        **figures,
    )


def map_checksum(calibration: Calibration) -> str:
    """Return 16 hex digits that identify a calibration's map by its weights, trims left out."""
    parts = [",".join(calibration.servo_names)]
    for numbers in (
        calibration.rest,
        calibration.rest_deg,
        calibration.weights,
        calibration.quadratic_weights,
    ):
        parts += [f"{number:.6g}" for number in numbers.ravel()]
    return hashlib.sha256(" ".join(parts).encode()).hexdigest()[:16]
