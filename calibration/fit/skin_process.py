"""One Gaussian process over joints and skin: neighbouring markers move alike, almost linearly.

    cov(marker p at pose x, marker q at pose y) = K(x, y) S(p, q), each axis for itself, plus noise
    K(x, y) = K0 + s + curvature s^2, s = sum_j reach_j x_j y_j     (lines, squares, products)
    S(p, q) = exp(-d(p, q)^2 / 2 width^2),                       d along the skin

The covariance is a Kronecker product, so two small eigendecompositions solve it (Rasmussen and
Williams, Gaussian Processes for Machine Learning, 2006, sections 2.2 and 5.4.1). The backlash of
the joints, their reaches, curvature, width and noise are hyperparameters; those are taken that
minimise the negative log likelihood of the capture.
Loads SciPy; the live path never does.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize

from lipsync.arrays import Array
from lipsync.markers import MARKERS_47

#: Variance of where a marker is on average, mm^2: unknown.
_CONSTANT_MM2 = 100.0
#: The backlashes of one robot are like one another by so much, about a common mean.
_BACKLASH_SD_DEG = 0.4
_FIRST_BACKLASH_DEG = 0.5
#: What noise gives a gear without play is as often less as more; no gear has so much less.
_MOST_BELOW_DEG = 2.0
#: Where the search for the hyperparameters begins: reach in mm^2 of a half range, curvature per
#: mm^2, noise in mm^2, width in mm. It ends at the same place from half or twice these.
_START = (3.0, 0.02, 0.3, 14.0)
_MOST_STEPS = 200

_UPPER_LIP = (39, 37, 0, 267, 269, 82, 13, 312)
_LOWER_LIP = (405, 314, 17, 84, 181, 317, 14, 87)
#: The two lips count as this far from their corners across the slit, one up and one down, so that
#: closed lips are not taken for one piece. Between 10 and 20 mm nothing changes by 0.01 mm.
_SLIT_MM = 15.0


@dataclass(frozen=True, slots=True)
class Poses:
    """Captured poses; as inputs they are scaled to -1..1 over each joint's captured range.

    goals_deg, from_below: (n, n_servos), from_below 1 or -1, the side that a pose is reached from.
    """

    goals_deg: Array
    from_below: Array
    middle_deg: Array
    half_range_deg: Array

    def inputs(self, backlash_deg: Array) -> Array:
        """Return the horns' angles, scaled to -1..1; they lag behind goals by half the backlash.

        Parameters
        ----------
        backlash_deg : Array
            (n_servos,) degrees, the whole width of the backlash.

        Returns
        -------
        Array
            (n, n_servos), without unit.
        """
        reached_deg = self.goals_deg - self.from_below * backlash_deg / 2
        return np.asarray((reached_deg - self.middle_deg) / self.half_range_deg)


@dataclass(frozen=True, slots=True)
class Hyperparameters:
    """Hyperparameters of a skin process, as in this module's formulae.

    backlash_deg, reach_mm2: (n_servos,); width_mm: of the covariance along the skin.
    """

    backlash_deg: Array
    reach_mm2: Array
    curvature: float
    noise_mm2: float
    width_mm: float

    def pose_covariance(self, one: Array, other: Array) -> Array:
        """Return the covariance K of two sets of poses.

        Parameters
        ----------
        one : Array
            (n, n_servos), scaled to -1..1.
        other : Array
            (m, n_servos), scaled to -1..1.

        Returns
        -------
        Array
            (n, m) mm^2.
        """
        straight = (one * self.reach_mm2) @ other.T
        return np.asarray(_CONSTANT_MM2 + straight + self.curvature * straight**2)

    def skin_covariance(self, apart_mm2: Array) -> Array:
        """Return the covariance S of markers.

        Parameters
        ----------
        apart_mm2 : Array
            (n_markers, n_markers) mm^2, squared distances along the skin.

        Returns
        -------
        Array
            (n_markers, n_markers).
        """
        return np.asarray(np.exp(-0.5 * apart_mm2 / self.width_mm**2))


@dataclass(frozen=True, slots=True)
class SkinProcess:
    """A Gaussian process of a face, fitted at `inputs` (n, n_servos).

    solved: (n, n_markers, 3), weights of each captured pose in a prediction.
    """

    hyperparameters: Hyperparameters
    inputs: Array
    solved: Array

    def predict(self, inputs: Array) -> Array:
        """Return the markers that the process predicts for poses.

        Parameters
        ----------
        inputs : Array
            (m, n_servos), scaled to -1..1.

        Returns
        -------
        Array
            (m, n_markers, 3) mm from each marker's mean position.
        """
        weights = self.hyperparameters.pose_covariance(inputs, self.inputs)
        return np.asarray(np.tensordot(weights, self.solved, axes=1))


def squared_distances_mm2(marker_names: Sequence[str], rest_mm: Array) -> Array:
    """Return squared distances of markers along the skin, which is slit at the mouth.

    A fourth dimension sets the upper lip's markers 15 mm off to one side, the lower lip's to the
    other, so that closed lips are not near each other.

    Parameters
    ----------
    marker_names : Sequence[str]
        Names of the n_markers markers.
    rest_mm : Array
        (n_markers, 3) mm.

    Returns
    -------
    Array
        (n_markers, n_markers) mm^2.
    """
    beyond_slit_mm = np.array([_SLIT_MM * _side(name) for name in marker_names])
    places_mm = np.column_stack([rest_mm, beyond_slit_mm])
    return np.asarray(np.sum((places_mm[:, None] - places_mm) ** 2, axis=2))


def _side(name: str) -> float:
    """Return 1 for an upper lip's marker, -1 for a lower lip's, 0 for others and the corners."""
    if name not in MARKERS_47.names:
        return 0.0
    landmark = MARKERS_47.landmarks[MARKERS_47.names.index(name)]
    return float(landmark in _UPPER_LIP) - float(landmark in _LOWER_LIP)


def fit_hyperparameters(
    poses: Poses,
    from_centre_mm: Array,
    apart_mm2: Array,
) -> Hyperparameters:
    """Return the likeliest hyperparameters of a capture, the backlash included.

    Parameters
    ----------
    poses : Poses
        The n captured poses.
    from_centre_mm : Array
        (n, n_markers, axes) mm, without NaN.
    apart_mm2 : Array
        (n_markers, n_markers) mm^2, squared distances along the skin.

    Returns
    -------
    Hyperparameters
        Lengths in mm.
    """
    n_servos = poses.goals_deg.shape[1]
    likelihood = _NegativeLogLikelihood(poses, from_centre_mm, apart_mm2)
    start = np.concatenate(
        [
            np.full(n_servos, _FIRST_BACKLASH_DEG),
            np.log(np.concatenate([np.full(n_servos, _START[0]), _START[1:]])),
        ]
    )
    bounds: list[tuple[float, float | None]] = [(-_MOST_BELOW_DEG, None)] * n_servos
    bounds += [(-20.0, 20.0)] * (n_servos + 3)
    solution = minimize(
        likelihood,
        start,
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={"maxiter": _MOST_STEPS},
    )
    found = _hyperparameters_of(solution.x, n_servos)
    return replace(found, backlash_deg=np.maximum(found.backlash_deg, 0.0))


def fit_process(
    hyperparameters: Hyperparameters, inputs: Array, from_centre_mm: Array, apart_mm2: Array
) -> SkinProcess:
    """Return the Gaussian process of the skin, conditioned on the markers of captured poses.

    Parameters
    ----------
    hyperparameters : Hyperparameters
        Hyperparameters of the process.
    inputs : Array
        (n, n_servos), scaled to -1..1.
    from_centre_mm : Array
        (n, n_markers, 3) mm.
    apart_mm2 : Array
        (n_markers, n_markers) mm^2, squared distances along the skin.

    Returns
    -------
    SkinProcess
        Predicts markers in mm.
    """
    eig = _KroneckerEigen(
        hyperparameters.pose_covariance(inputs, inputs),
        hyperparameters.skin_covariance(apart_mm2),
        hyperparameters.noise_mm2,
    )
    # Inverse of the covariance times the markers, then times the covariance of the skin.
    weighted = eig.rotated(from_centre_mm) / eig.variance[:, :, None]
    by_marker = (hyperparameters.skin_covariance(apart_mm2) @ eig.skin_vectors) @ weighted
    solved = (eig.pose_vectors @ by_marker.reshape(len(inputs), -1)).reshape(by_marker.shape)
    return SkinProcess(hyperparameters, inputs, solved)


def _hyperparameters_of(parameters: Array, n_servos: int) -> Hyperparameters:
    """Return the hyperparameters in a vector: backlashes in degrees, then logarithms of all others.

    parameters: (2 n_servos + 3,): backlash, reach, curvature, noise and width.
    """
    reach = np.exp(parameters[n_servos : 2 * n_servos])
    curvature, noise, width = np.exp(parameters[2 * n_servos :]).tolist()
    return Hyperparameters(parameters[:n_servos], reach, curvature, noise, width)


class _KroneckerEigen:
    """Eigendecompositions of the covariances of poses and of skin, for solving with both at once.

    variance: (n, n_markers), of each pair of a pose's and a skin's eigenvector, with noise.
    """

    def __init__(self, joints: Array, skin: Array, noise_mm2: float) -> None:
        self.pose_values, self.pose_vectors = np.linalg.eigh(joints)
        self.skin_values, self.skin_vectors = np.linalg.eigh(skin)
        sizes = np.outer(self.pose_values, self.skin_values)
        self.variance = np.maximum(sizes, 0.0) + noise_mm2

    def rotated(self, values: Array) -> Array:
        """Return values (n, n_markers, 3) in the coordinates of both sets of eigenvectors."""
        n, m, axes = values.shape
        by_pose = (self.pose_vectors.T @ values.reshape(n, -1)).reshape(n, m, axes)
        return np.asarray(self.skin_vectors.T @ by_pose)


class _NegativeLogLikelihood:
    """A function from parameters to the negative log likelihood of a capture and its gradient.

    Parameters: backlash in degrees, then the logarithms of the other hyperparameters.
    """

    def __init__(self, poses: Poses, from_centre_mm: Array, apart_mm2: Array) -> None:
        self._poses = poses
        self._values = from_centre_mm
        self._apart = apart_mm2

    def __call__(self, parameters: Array) -> tuple[float, Array]:
        """Return the negative log likelihood, up to a constant, and its gradient by `parameters`.

        parameters: (2 n_servos + 3,), in the order of `_hyperparameters_of`. Included is the prior
        that the backlashes of one robot are alike. Names with d_ are derivatives of the cost
        (Rasmussen and Williams, equation 5.9).
        """
        hyperparameters = _hyperparameters_of(parameters, self._poses.goals_deg.shape[1])
        x = self._poses.inputs(hyperparameters.backlash_deg)
        eig = _KroneckerEigen(
            hyperparameters.pose_covariance(x, x),
            hyperparameters.skin_covariance(self._apart),
            hyperparameters.noise_mm2,
        )
        turned = eig.rotated(self._values)
        # The inverse of the covariance times the markers, in the eigenvectors' coordinates.
        solved = turned / eig.variance[:, :, None]
        axes = self._values.shape[2]
        cost = 0.5 * float((turned * solved).sum()) + 0.5 * axes * float(np.log(eig.variance).sum())

        n_poses, n_markers = eig.variance.shape
        scaled = solved * eig.skin_values[:, None]
        d_pose = -(solved.reshape(n_poses, -1) @ scaled.reshape(n_poses, -1).T)
        d_pose += np.diag(axes * (eig.skin_values / eig.variance).sum(axis=1))
        d_joints = 0.5 * eig.pose_vectors @ d_pose @ eig.pose_vectors.T
        by_marker = solved.transpose(1, 0, 2)
        scaled = by_marker * eig.pose_values[:, None]
        d_point = -(by_marker.reshape(n_markers, -1) @ scaled.reshape(n_markers, -1).T)
        d_point += np.diag(axes * (eig.pose_values[:, None] / eig.variance).sum(axis=0))
        d_skin = 0.5 * eig.skin_vectors @ d_point @ eig.skin_vectors.T
        d_noise = 0.5 * (axes * (1.0 / eig.variance).sum() - (solved**2).sum())

        straight = (x * hyperparameters.reach_mm2) @ x.T
        # From the covariance of poses on to the angles and their hyperparameters.
        d_straight = d_joints * (1.0 + 2.0 * hyperparameters.curvature * straight)
        d_input = 2.0 * d_straight @ (x * hyperparameters.reach_mm2)
        d_backlash = (d_input * -self._poses.from_below / 2 / self._poses.half_range_deg).sum(
            axis=0
        )
        from_mean = hyperparameters.backlash_deg - hyperparameters.backlash_deg.mean()
        cost += 0.5 * float((from_mean**2).sum()) / _BACKLASH_SD_DEG**2
        d_backlash += from_mean / _BACKLASH_SD_DEG**2
        d_reach = (x * (d_straight @ x)).sum(axis=0)
        alike = np.exp(-0.5 * self._apart / hyperparameters.width_mm**2)
        # By the logarithms: each derivative times its hyperparameter.
        d_others = [
            hyperparameters.curvature * (d_joints * straight**2).sum(),
            hyperparameters.noise_mm2 * d_noise,
            (d_skin * alike * self._apart).sum() / hyperparameters.width_mm**2,
        ]
        return cost, np.concatenate([d_backlash, hyperparameters.reach_mm2 * d_reach, d_others])
