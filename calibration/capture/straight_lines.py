"""Captured markers by joint, in lines nearly straight that single wrong points do not bend.

Lost points are filled in, points that are far off are left out, and both are counted.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calibration.capture.capture import Capture
from lipsync.arrays import Array

#: Rounds of filling in and leaving out.
_ROUNDS = 8
#: A point is left out beyond so many times its marker's usual distance from the line (1.54 sigma),
#: and never nearer than so: the skin is not straight.
_TIMES, _LEAST_MM = 5.0, 4.0
#: Each joint bends its own way where there are so many poses for every number that is fitted.
_POSES_PER_TERM = 2.0
#: No tracker means such a number, and no marker of a mouth goes so far from its usual place in the
#: head: such a reading would bend every line before it could be told.
_SENSELESS_MM, _FARTHEST_MM = 1e5, 80.0


@dataclass(frozen=True, slots=True)
class StraightLines:
    """What each joint does, and what does not fit.

    slopes_mm: (n_servos, n_markers, 3), over each joint's captured range; chance_mm: (n_servos,),
    what noise alone gives them in each axis; expected_mm as captured; far: (n, n_markers), the
    points that are left out; noise_mm: in each axis, what is not straight included; own_noise_mm:
    (n_markers,), the same of each marker.
    """

    slopes_mm: Array
    chance_mm: Array
    expected_mm: Array
    far: NDArray[np.bool_]
    noise_mm: float
    own_noise_mm: Array


def straight_lines(capture: Capture) -> StraightLines:
    """By least squares in rounds, without what is far off."""
    low, high = capture.goals_deg.min(axis=0), capture.goals_deg.max(axis=0)
    x = (capture.goals_deg - low) / np.maximum(high - low, 1e-6) - 0.5
    n_servos = x.shape[1]
    inputs = np.hstack([x, np.ones((len(x), 1))])
    if len(x) > _POSES_PER_TERM * (2 * n_servos + 1):
        inputs = np.hstack([inputs, x**2])
    seen_mm = np.where(np.abs(capture.markers_mm) < _SENSELESS_MM, capture.markers_mm, np.nan)
    usual_mm = np.nanmedian(seen_mm, axis=0)
    expected_mm = np.broadcast_to(usual_mm, seen_mm.shape)
    senseless: NDArray[np.bool_] = np.asarray(~np.isfinite(seen_mm).all(axis=2))
    apart_mm = np.where(senseless[..., None], 0.0, seen_mm - usual_mm)
    apart_mm -= np.median(apart_mm, axis=1, keepdims=True)  # a head that moves takes all along
    senseless |= ~senseless & (np.linalg.norm(apart_mm, axis=2) > _FARTHEST_MM)
    far: NDArray[np.bool_] = senseless.copy()
    for _ in range(_ROUNDS):
        filled_mm = np.where(far[..., None], expected_mm, seen_mm)
        fit = np.linalg.lstsq(inputs, filled_mm.reshape(len(inputs), -1), rcond=None)[0]
        expected_mm = (inputs @ fit).reshape(seen_mm.shape)
        off_mm = np.linalg.norm(np.nan_to_num(seen_mm - expected_mm), axis=2)
        usual_off_mm = np.median(off_mm, axis=0)
        beyond = off_mm > np.maximum(_TIMES * usual_off_mm, _LEAST_MM)
        # The farthest of each marker first: it bends the line, and may make good ones look bad.
        farthest = off_mm >= np.where(far, 0.0, off_mm).max(axis=0)
        far = np.asarray(senseless | (beyond & (far | farthest)))
    left_mm2 = np.sum((filled_mm - expected_mm) ** 2)
    freedom = max(1, filled_mm[0].size * (len(inputs) - inputs.shape[1]))
    noise_mm2 = left_mm2 / freedom
    chance_mm = np.sqrt(noise_mm2 * np.diag(np.linalg.pinv(inputs.T @ inputs))[:n_servos])
    freedom_of_one = max(1, 3 * (len(inputs) - inputs.shape[1]))
    own_mm = np.sqrt(np.sum((filled_mm - expected_mm) ** 2, axis=(0, 2)) / freedom_of_one)
    slopes_mm = fit[:n_servos].reshape(-1, *usual_mm.shape)
    return StraightLines(slopes_mm, chance_mm, expected_mm, far, float(np.sqrt(noise_mm2)), own_mm)


def without_far_points(capture: Capture, lines: StraightLines) -> tuple[Capture, tuple[str, ...]]:
    """The capture with points that are far off counted as lost, and a line that says so."""
    left_out = lines.far & np.isfinite(capture.markers_mm).all(axis=2)
    if not left_out.any():
        return capture, ()
    by_marker = left_out.sum(axis=0)
    most = sorted(zip(by_marker, capture.marker_names, strict=True), reverse=True)[:5]
    told = ", ".join(f"{name} {count}" for count, name in most if count)
    others = ", ..." if (by_marker > 0).sum() > len(most) else ""
    markers_mm = np.where(left_out[..., None], np.nan, capture.markers_mm)
    return (
        replace(capture, markers_mm=markers_mm),
        (f"{left_out.sum()} readings were far off and left out: {told}{others}",),
    )
