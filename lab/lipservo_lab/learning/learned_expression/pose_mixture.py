"""Where a head goes next: a Gaussian mixture over pose, velocity, acceleration, pitch, loudness.

After Le, Ma and Deng, "Live speech driven head-and-eye motion generators", IEEE TVCG 18(11), 2012,
whose head motion is the pose of greatest likelihood under such a mixture, found by gradient ascent.
The equations here are ours. With v_t = (th_t - th_t-1) / dt and a_t = (v_t - v_t-1) / dt, and
(th, v, a) a linear map of three poses in a row, p(x_t) seen as a function of th_t alone is the
conditional density of the next pose given two poses and the prosody: what it peaks at is the
likeliest pose, what is drawn from it moves as much as the recorded head did.

Cholesky factors of 3 x 3 matrices in plain numbers: NumPy's take ten times as long to call.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from lipsync.arrays import Array

#: l11, l21, l22, l31, l32, l33 of the lower triangle L, with L L' = A.
Factor = tuple[float, float, float, float, float, float]
Three = tuple[float, float, float]


def factor_of(matrix: list[list[float]]) -> Factor:
    """The factor of a symmetric positive definite matrix; ValueError for another."""
    (a11, _, _), (a21, a22, _), (a31, a32, a33) = matrix
    l11 = math.sqrt(a11)
    l21, l31 = a21 / l11, a31 / l11
    l22 = math.sqrt(a22 - l21 * l21)
    l32 = (a32 - l31 * l21) / l22
    return l11, l21, l22, l31, l32, math.sqrt(a33 - l31 * l31 - l32 * l32)


def solve_lower(factor: Factor, b: Sequence[float]) -> Three:
    """Y with L y = b."""
    l11, l21, l22, l31, l32, l33 = factor
    y1 = b[0] / l11
    y2 = (b[1] - l21 * y1) / l22
    return y1, y2, (b[2] - l31 * y1 - l32 * y2) / l33


def solve_upper(factor: Factor, y: Sequence[float]) -> Three:
    """X with L' x = y; after `solve_lower` the x of A x = b."""
    l11, l21, l22, l31, l32, l33 = factor
    x3 = y[2] / l33
    x2 = (y[1] - l32 * x3) / l22
    return (y[0] - l21 * x2 - l31 * x3) / l11, x2, x3


#: Pitch, yaw, roll in degrees; their velocities and accelerations; pitch and loudness of the voice.
N_AXES, N_FEATURES = 3, 11
#: Nine of ten poses are within 0.002 degrees of the top then (grid_s1, measured).
_ROUNDS = 2


@dataclass(frozen=True, slots=True)
class PoseMixture:
    """weights (K,), means (K, 11), precisions (K, 11, 11) of x; period_s between two poses.

    Raises ValueError for shapes that do not fit, for what is no number and for precisions that are
    not positive definite.
    """

    weights: Array
    means: Array
    precisions: Array
    period_s: float
    _of_pose: Array = field(init=False, repr=False, compare=False)
    _curvatures: Array = field(init=False, repr=False, compare=False)
    _flat_curvatures: Array = field(init=False, repr=False, compare=False)
    _log_scales: Array = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        n = len(self.weights)
        if self.means.shape != (n, N_FEATURES) or self.precisions.shape != (n, 11, 11) or not n:
            raise ValueError("the parts of the mixture differ in shape")
        if not (np.isfinite(self.weights).all() and np.isfinite(self.means).all()):
            raise ValueError("the mixture holds values that are no numbers")
        if not (self.weights > 0.0).all() or not 0.0 < self.period_s < math.inf:
            raise ValueError("weights and period of the mixture are above 0")
        try:
            factors = np.linalg.cholesky(self.precisions)
        except np.linalg.LinAlgError:
            raise ValueError("a precision of the mixture is not positive definite") from None
        per_s = 1.0 / self.period_s
        # x = c + B th: what one degree of the new pose does to each feature.
        of_pose = np.zeros((N_FEATURES, N_AXES))
        for row, scale in enumerate((1.0, per_s, per_s * per_s)):
            of_pose[3 * row : 3 * row + 3] = scale * np.eye(N_AXES)
        half_log_det = np.log(np.diagonal(factors, axis1=1, axis2=2)).sum(axis=1)
        object.__setattr__(self, "_of_pose", of_pose)
        curvatures = of_pose.T @ self.precisions @ of_pose
        object.__setattr__(self, "_curvatures", curvatures)
        object.__setattr__(self, "_flat_curvatures", curvatures.reshape(n, -1))
        object.__setattr__(self, "_log_scales", np.log(self.weights) + half_log_det)

    def log_density(self, features: Array) -> float:
        """Return log p(x), less the constant -11/2 log 2 pi.

        Parameters
        ----------
        features : Array
            (11,).

        Returns
        -------
        float
            Its logarithm.
        """
        away = self.means - features
        squares = np.einsum("ki,kij,kj->k", away, self.precisions, away)
        logs = self._log_scales - 0.5 * squares
        return float(logs.max() + np.log(np.exp(logs - logs.max()).sum()))

    def features(self, poses_deg: tuple[Array, Array, Array], prosody: Array) -> Array:
        """Return x of three poses and prosody.

        Parameters
        ----------
        poses_deg : tuple[Array, Array, Array]
            (3,) each: the pose before last, the last, the new one.
        prosody : Array
            (2,): pitch and loudness z.

        Returns
        -------
        Array
            (11,).
        """
        before, last, new = poses_deg
        per_s = 1.0 / self.period_s
        acceleration = (new - 2.0 * last + before) * (per_s * per_s)
        return np.concatenate((new, (new - last) * per_s, acceleration, prosody))

    def next_pose(self, before: Array, last: Array, prosody: Array) -> tuple[Array, Factor]:
        """Return the likeliest pose after two, and the Cholesky factor of the curvature there.

        Gauss-Newton ascent from the extrapolated pose 2 last - before. Each component is quadratic
        in the pose; a round weighs them by how likely they made it and goes to the top of their
        sum, which never lowers the density (as an EM step).

        Parameters
        ----------
        before,last : Array
            (3,) degrees.
        prosody : Array
            (2,): pitch and loudness z.

        Returns
        -------
        tuple[Array, Factor]
            (3,) degrees, and (3, 3).
        """
        fixed = self.features((before, last, np.zeros(N_AXES)), prosody)
        away = self.means - fixed
        pulled = np.matmul(self.precisions, away[:, :, None])[:, :, 0]
        heights = self._log_scales - 0.5 * (away * pulled).sum(axis=1)
        slopes = pulled @ self._of_pose
        pose = 2.0 * last - before
        for _ in range(_ROUNDS):
            bent = self._curvatures @ pose
            logs = heights + (slopes - 0.5 * bent) @ pose
            shares = np.exp(logs - logs.max())
            shares /= shares.sum()
            curvature = shares @ self._flat_curvatures
            factor = factor_of(curvature.reshape(N_AXES, N_AXES).tolist())
            pose = np.array(solve_upper(factor, solve_lower(factor, (shares @ slopes).tolist())))
        return pose, factor
