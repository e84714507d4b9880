"""How far a jaw is open, as one number: the blend of a closed and an open jaw line.

Edge, Hilton and Jackson fit the jaw of a face by one parameter alpha for each frame, minimising
sum_i || m_i - ((1 - alpha) c_i + alpha o_i) ||^2 over the jaw line, by Newton's method with finite
differences. For mouths of one servo, and as a check of others.
"""

from dataclasses import dataclass

import numpy as np

from calibration.calibration import CalibrationError
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array
from lipsync.markers import MARKERS_47

#: The markers that ride on the jaw.
JAW_LINE: tuple[int, ...] = tuple(
    i for i, name in enumerate(MARKERS_47.names) if name.startswith(("jaw", "chin"))
)
#: The cost is quadratic, so differences of any size are exact; this one is far from rounding.
_DIFFERENCE = 0.1
#: Newton is there after one step; the second only takes away rounding.
_STEPS = 2
#: A jaw line that moves less than this between closed and open says nothing.
_LEAST_MOTION_MM = 1.0
#: The speaker's open jaw: wider is rare.
_OPEN_QUANTILE = 0.98


@dataclass(frozen=True, slots=True)
class JawBlend:
    """closed_mm, open_mm: (n_points, 3), the two ends of the blend."""

    closed_mm: Array
    open_mm: Array

    def cost_mm2(self, alpha: Array, points_mm: Array) -> Array:
        """(n,) and (n, n_points, 3) -> (n,): sum of squared distances from the blend."""
        blend = self.closed_mm + alpha[:, None, None] * (self.open_mm - self.closed_mm)
        return np.asarray(np.sum((points_mm - blend) ** 2, axis=(1, 2)))

    def alpha(self, points_mm: Array) -> Array:
        """(n, n_points, 3) -> (n,): 0 closed, 1 open, beyond either where the jaw is.

        Newton with central differences from 0.
        """
        alpha = np.zeros(len(points_mm))
        for _ in range(_STEPS):
            before, at, after = (
                self.cost_mm2(alpha + step, points_mm) for step in (-_DIFFERENCE, 0.0, _DIFFERENCE)
            )
            slope = (after - before) / (2 * _DIFFERENCE)
            bend = (after - 2 * at + before) / _DIFFERENCE**2
            alpha = alpha - slope / bend
        return alpha


def speakers_jaw(model: FaceWithAnimPhos) -> JawBlend:
    """From the model's rest to the mean of its widest open frames.

    Raises CalibrationError for a speaker whose jaw line hardly moves.
    """
    frames = model.animphos.frames
    line = list(JAW_LINE)
    markers_mm = model.markers_mm(frames)[:, line]
    height_mm = markers_mm[:, :, 1].mean(axis=1)
    widest = height_mm <= np.quantile(height_mm, 1.0 - _OPEN_QUANTILE)
    return jaw_blend(model.markers_mm(model.rest[None])[0, line], markers_mm[widest].mean(axis=0))


def jaw_blend(closed_mm: Array, open_mm: Array) -> JawBlend:
    """Raises CalibrationError where the two hardly differ."""
    apart_mm = float(np.linalg.norm(open_mm - closed_mm, axis=1).max())
    if apart_mm < _LEAST_MOTION_MM:
        raise CalibrationError(
            f"the jaw line moves by {apart_mm:.1f} mm between closed and open; "
            "markers on the chin are needed"
        )
    return JawBlend(closed_mm, open_mm)


@dataclass(frozen=True, slots=True)
class JawDegrees:
    """Blend to degrees, from a sweep of the robot's jaw: alphas ascending, (n,), and degrees."""

    alphas: Array
    degrees: Array

    def degrees_at(self, alpha: Array) -> Array:
        """(n,) -> (n,), straight between what was measured, held beyond."""
        return np.asarray(np.interp(alpha, self.alphas, self.degrees))


def jaw_degrees(blend: JawBlend, degrees: Array, points_mm: Array) -> JawDegrees:
    """From a sweep: degrees (n,), ascending, and the robot's jaw line there, (n, n_points, 3).

    Raises CalibrationError where the jaw does not open steadily with its angle.
    """
    alphas = blend.alpha(points_mm)
    if len(degrees) < 2 or (np.diff(degrees) <= 0).any() or (np.diff(alphas) <= 0).any():
        raise CalibrationError(
            "the jaw does not open steadily with its angle; sweep it again, or turn its `sign`"
        )
    return JawDegrees(alphas, degrees.copy())
