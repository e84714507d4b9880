"""Lines through captured markers over each joint's angle, robust against single wrong points.

Lost points are filled in, outliers are left out, and both are counted. Markers are referred to the
head where a tripod was knocked or a camera held in the hand: the nose does not move with the mouth.
Where its markers move together, by more than the tracker's noise, each reading is laid on the usual
position of the rigid markers by the best rotation and shift (Kabsch 1976).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.capture.capture import Capture
from lipsync.arrays import Array

#: Rounds of filling in and leaving out.
_ROUNDS = 8
#: A point is left out beyond so many times its marker's usual distance from the line (1.54 sigma),
#: and never nearer than so: the skin is not straight.
_OUTLIER_TIMES, _LEAST_OUTLIER_MM = 5.0, 4.0
#: Each joint bends its own way where there are so many poses for every number that is fitted.
_POSES_PER_TERM = 2.0
#: No tracker means such a number, and no marker of a mouth goes so far from its usual place in the
#: head: such a reading would bend every line before it could be told.
_SENSELESS_MM, _FARTHEST_MM = 1e5, 80.0


@dataclass(frozen=True, slots=True)
class StraightLines:
    """How each joint moves the markers, by fitted lines, and the points off these lines.

    slopes_mm: (n_servos, n_markers, 3), over each joint's captured range; chance_mm: (n_servos,),
    standard error of the slopes in each axis; expected_mm: (n, n_markers, 3), the fitted markers;
    far: (n, n_markers), points that are left out; noise_mm: rms distance from the lines in each
    axis; own_noise_mm: (n_markers,), that distance of each marker.
    """

    slopes_mm: Array
    chance_mm: Array
    expected_mm: Array
    far: NDArray[np.bool_]
    noise_mm: float
    own_noise_mm: Array


def straight_lines(capture: Capture) -> StraightLines:
    """Return lines through the markers, fitted in rounds by least squares without outliers.

    In each round lost points and outliers are replaced by what the lines predict, and outliers are
    looked for anew.
    """
    low, high = capture.goals_deg.min(axis=0), capture.goals_deg.max(axis=0)
    # Angles scaled to -0.5..0.5, so that a slope is the motion over the captured range.
    x = (capture.goals_deg - low) / np.maximum(high - low, 1e-6) - 0.5
    n_servos = x.shape[1]
    # One line per joint and a constant; with enough poses each joint also bends.
    inputs = np.hstack([x, np.ones((len(x), 1))])
    if len(x) > _POSES_PER_TERM * (2 * n_servos + 1):
        inputs = np.hstack([inputs, x**2])
    # Coordinates too large for any tracker count as lost.
    seen_mm = np.where(np.abs(capture.markers_mm) < _SENSELESS_MM, capture.markers_mm, np.nan)
    usual_mm = np.nanmedian(seen_mm, axis=0)
    expected_mm = np.broadcast_to(usual_mm, seen_mm.shape)
    senseless: NDArray[np.bool_] = np.asarray(~np.isfinite(seen_mm).all(axis=2))
    offset_mm = np.where(senseless[..., None], 0.0, seen_mm - usual_mm)
    offset_mm -= np.median(offset_mm, axis=1, keepdims=True)  # a head that moves takes all along
    # Nor can a marker be that far from its usual place in the head.
    senseless |= ~senseless & (np.linalg.norm(offset_mm, axis=2) > _FARTHEST_MM)
    far: NDArray[np.bool_] = senseless.copy()
    for _ in range(_ROUNDS):
        filled_mm = np.where(far[..., None], expected_mm, seen_mm)
        fit = np.linalg.lstsq(inputs, filled_mm.reshape(len(inputs), -1), rcond=None)[0]
        expected_mm = (inputs @ fit).reshape(seen_mm.shape)
        off_mm = np.linalg.norm(np.nan_to_num(seen_mm - expected_mm), axis=2)
        median_off_mm = np.median(off_mm, axis=0)
        beyond = off_mm > np.maximum(_OUTLIER_TIMES * median_off_mm, _LEAST_OUTLIER_MM)
        # A new outlier must also be the farthest reading of its marker: the farthest bends the
        # line, and may make good readings look bad.
        farthest = off_mm >= np.where(far, 0.0, off_mm).max(axis=0)
        far = np.asarray(senseless | (beyond & (far | farthest)))
    # Residuals over degrees of freedom: the noise in each axis, the standard error of the slopes by
    # it, and the noise of each marker.
    residual_mm2 = np.sum((filled_mm - expected_mm) ** 2)
    n_free = max(1, filled_mm[0].size * (len(inputs) - inputs.shape[1]))
    noise_mm2 = residual_mm2 / n_free
    chance_mm = np.sqrt(noise_mm2 * np.diag(np.linalg.pinv(inputs.T @ inputs))[:n_servos])
    n_free_of_marker = max(1, 3 * (len(inputs) - inputs.shape[1]))
    own_mm = np.sqrt(np.sum((filled_mm - expected_mm) ** 2, axis=(0, 2)) / n_free_of_marker)
    slopes_mm = fit[:n_servos].reshape(-1, *usual_mm.shape)
    return StraightLines(slopes_mm, chance_mm, expected_mm, far, float(np.sqrt(noise_mm2)), own_mm)


def without_far_points(capture: Capture, lines: StraightLines) -> tuple[Capture, tuple[str, ...]]:
    """Return the capture with outliers of `lines` as NaN, and a line about them; () without any."""
    left_out = lines.far & np.isfinite(capture.markers_mm).all(axis=2)
    if not left_out.any():
        return capture, ()
    markers_mm = np.where(left_out[..., None], np.nan, capture.markers_mm)
    return replace(capture, markers_mm=markers_mm), outlier_line(left_out, capture.marker_names)


def outlier_line(left_out: NDArray[np.bool_], names: Sequence[str]) -> tuple[str, ...]:
    """Return a line about readings that are left out; () if there are none.

    Parameters
    ----------
    left_out : NDArray[np.bool_]
        (n, n_markers), of n poses.
    names : Sequence[str]
        Names of the markers.
    """
    counts = left_out.sum(axis=0)
    most_often = sorted(zip(counts.tolist(), names, strict=True), reverse=True)[:5]
    counted = ", ".join(f"{name} {count}" for count, name in most_often if count)
    others = ", ..." if (counts > 0).sum() > len(most_often) else ""
    text = f"{left_out.sum()} readings were far off and left out: {counted}{others}"
    return (text,) if counted else ()


_RIGID = ("nose", "cheek_50", "cheek_280")
_LEAST_MARKERS = 3
#: Three dots on a nose, noisy as they are, say nothing of how the lips below them are turned.
_LEAST_TO_TURN = 5
#: What no joint explains must move the nose as one piece by so much, rms, and by so many times what
#: the noise of single markers would.
_LEAST_SHIFT_MM, _NOISE_TIMES = 1.2, 2.0


def in_head_frame(capture: Capture, lines: StraightLines) -> tuple[Capture, tuple[str, ...]]:
    """Return the capture with each pose laid on the usual rigid markers, and a line for the user.

    The capture is unchanged, and there is no line, if the head is still, fewer than three nose
    markers are captured, or all of them are seen together in less than half of the poses.
    """
    nose = [i for i, name in enumerate(capture.marker_names) if name.startswith("nose")]
    rigid = [i for i, name in enumerate(capture.marker_names) if name.startswith(_RIGID)]
    if len(nose) < _LEAST_MARKERS:
        return capture, ()
    usual_mm = np.nanmedian(capture.markers_mm, axis=0)
    off_mm = capture.markers_mm[:, nose] - lines.expected_mm[:, nose]
    nose_seen = np.isfinite(off_mm).all(axis=(1, 2))
    if nose_seen.sum() < len(capture) / 2:
        return capture, ()
    # What the lines leave unexplained: the nose's shift as one piece, and the scatter of its
    # markers, which gives the shift that noise alone would cause.
    rms_mm = _nose_shift_mm(capture.markers_mm - lines.expected_mm, nose)
    scatter_mm = (off_mm - _median_of_points(off_mm))[nose_seen]
    noise_mm = 1.4826 * float(np.median(np.abs(scatter_mm))) * np.sqrt(3.0 / len(nose)) * 1.5
    if rms_mm < max(_LEAST_SHIFT_MM, _NOISE_TIMES * noise_mm):
        return capture, ()
    laid_mm = capture.markers_mm.copy()
    for pose, points_mm in enumerate(capture.markers_mm):
        known = [i for i in rigid if np.isfinite(points_mm[i]).all()]
        if len(known) >= _LEAST_MARKERS:
            laid_mm[pose] = _align(points_mm, points_mm[known], usual_mm[known])
    return (
        replace(capture, markers_mm=laid_mm),
        (
            f"the head or the tracker moved by {rms_mm:.1f} mm (rms) during the capture: markers "
            "are counted from the nose; fix the tripod for a better calibration",
        ),
    )


def on_head(
    markers_mm: Array, usual_mm: Array, marker_names: tuple[str, ...]
) -> tuple[Array, bool]:
    """Lay markers on the usual position of the head, if the nose has moved from `usual_mm`.

    First all poses together as one rigid body, for a tripod that was moved; then pose by pose if
    the nose still moves.

    Parameters
    ----------
    markers_mm : Array
        (n, n_markers, 3) mm.
    usual_mm : Array
        (n, n_markers, 3) mm, usual positions of the markers.
    marker_names : tuple[str, ...]
        Names of the n_markers markers.

    Returns
    -------
    tuple[Array, bool]
        (n, n_markers, 3) mm, and whether they were laid on the head.
    """
    nose = [i for i, name in enumerate(marker_names) if name.startswith("nose")]
    rigid = [i for i, name in enumerate(marker_names) if name.startswith(_RIGID)]
    if len(nose) < _LEAST_MARKERS or _nose_shift_mm(markers_mm - usual_mm, nose) < _LEAST_SHIFT_MM:
        return markers_mm, False
    rigid_seen = np.asarray(np.isfinite(markers_mm[:, rigid]).all(axis=2))
    may_turn = len(rigid) >= _LEAST_TO_TURN
    seen_mm, wanted_mm = markers_mm[:, rigid][rigid_seen], usual_mm[:, rigid][rigid_seen]
    flat_mm = markers_mm.reshape(-1, 3)
    laid_mm = _align(flat_mm, seen_mm, wanted_mm, may_turn=may_turn).reshape(markers_mm.shape)
    if _nose_shift_mm(laid_mm - usual_mm, nose) < _LEAST_SHIFT_MM:
        return laid_mm, True
    for pose in np.flatnonzero(rigid_seen.sum(axis=1) >= _LEAST_MARKERS):
        rows = [i for i, is_known in zip(rigid, rigid_seen[pose], strict=True) if is_known]
        points_mm, usual_rigid_mm = laid_mm[pose], usual_mm[pose, rows]
        laid_mm[pose] = _align(points_mm, points_mm[rows], usual_rigid_mm, may_turn=may_turn)
    return laid_mm, True


def _nose_shift_mm(off_mm: Array, nose: list[int]) -> float:
    """Return the rms shift of the nose as one piece, over poses with all its markers; 0 if none.

    off_mm: (n, n_markers, 3), markers less their usual positions; nose: numbers of its markers.
    """
    nose_seen = np.isfinite(off_mm[:, nose]).all(axis=(1, 2))
    if not nose_seen.any():
        return 0.0
    shift_mm = _median_of_points(off_mm[nose_seen][:, nose])[:, 0]
    return float(np.sqrt(np.mean(np.sum(shift_mm**2, axis=1))))


def _median_of_points(points_mm: Array) -> Array:
    """Return the median of each pose's points: from (n, n_points, 3) to (n, 1, 3)."""
    return np.asarray(np.median(points_mm, axis=1, keepdims=True))


def _align(points_mm: Array, rigid_mm: Array, usual_mm: Array, *, may_turn: bool = True) -> Array:
    """Return points (n, 3) moved by the rotation and shift that lay rigid_mm on usual_mm best.

    rigid_mm, usual_mm: (k, 3), the same k points; may_turn False: by the shift alone. By singular
    values (Kabsch 1976).
    """
    centre, target = rigid_mm.mean(axis=0), usual_mm.mean(axis=0)
    if not may_turn:
        return np.asarray(points_mm - centre + target)
    # The best rotation; `turn` keeps it from being a reflection.
    left, _, right = np.linalg.svd((rigid_mm - centre).T @ (usual_mm - target))
    turn = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    return np.asarray((points_mm - centre) @ (left @ turn @ right) + target)
