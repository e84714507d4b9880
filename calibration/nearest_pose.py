"""Which servo angles bring the simulated face nearest to given marker positions."""

import numpy as np
from numpy.typing import NDArray

from calibration.simulated_face import SimulatedFace, marker_positions_mm
from lipsync.markers import LIP_MARKERS, MARKER_NAMES

Array = NDArray[np.float64]

#: Weights of a millimetre: lips are looked at, cheeks and chin only help; whether lips touch shows
#: most, so the three inner-lip gaps count on top of the lips themselves. Gap weights of 3, 6 and 10
#: left 0.14, 0.10 and 0.10 mm of gap error on grid_s1, and 0.81, 0.82 and 0.84 mm on the lips.
_LIP_WEIGHT, _SKIN_WEIGHT, _GAP_WEIGHT = 1.0, 0.3, 6.0
#: Millimetres a degree away from neutral is worth: decides between poses that look the same. From
#: 0.005 to 0.05 no error on grid_s1 changes by 0.005 mm.
_NEUTRAL_WEIGHT_MM_PER_DEG = 0.02
_UPPER_INNER, _LOWER_INNER = (
    [MARKER_NAMES.index(f"inner_lip_{n}") for n in row] for row in ((82, 13, 312), (87, 14, 317))
)

#: Enough for angles within 0.001 degree of where they would end, measured on grid_s1.
_ROUNDS = 4
_SWEEPS = 60
#: Small against the bend of the face, large against rounding.
_DIFFERENCE_DEG = 0.1


def nearest_positions_deg(
    face: SimulatedFace, markers_mm: Array, min_deg: Array, max_deg: Array
) -> Array:
    """(n, 47, 3) -> (n, n_servos) within the limits (n_servos,), in weighted least squares.

    Gauss-Newton from neutral; each round solves all frames' bounded quadratic problems at once.
    """
    target = _features(markers_mm)
    positions_deg = np.zeros((len(markers_mm), len(min_deg)))
    damping = _NEUTRAL_WEIGHT_MM_PER_DEG**2 * np.eye(len(min_deg))
    for _ in range(_ROUNDS):
        reached = _features(marker_positions_mm(face, positions_deg))
        jacobian = _jacobian(face, positions_deg, reached)
        transposed = jacobian.transpose(0, 2, 1)
        missing = target - reached + np.einsum("nks,ns->nk", jacobian, positions_deg)
        positions_deg = bounded_minimum(
            transposed @ jacobian + damping,
            np.einsum("nsk,nk->ns", transposed, missing),
            min_deg,
            max_deg,
        )
    return positions_deg


def bounded_minimum(matrices: Array, rights: Array, lower: Array, upper: Array) -> Array:
    """The x that minimises x'Ax/2 - b'x with lower <= x <= upper, for n problems at once.

    matrices: (n, k, k), positive definite; rights: (n, k); lower, upper: (k,). Coordinate descent:
    each coordinate in turn goes to its own bounded minimum, which converges for such problems.
    """
    x = np.clip(np.linalg.solve(matrices, rights[..., None])[..., 0], lower, upper)
    for _ in range(_SWEEPS):
        for i in range(len(lower)):
            slope = np.einsum("nk,nk->n", matrices[:, i], x) - rights[:, i]
            x[:, i] = np.clip(x[:, i] - slope / matrices[:, i, i], lower[i], upper[i])
    return np.asarray(x)


def _features(markers_mm: Array) -> Array:
    """(n, 47, 3) -> (n, 150): weighted positions, then weighted inner-lip gaps."""
    weight = np.full((len(MARKER_NAMES), 1), _SKIN_WEIGHT)
    weight[list(LIP_MARKERS)] = _LIP_WEIGHT
    gaps_mm = markers_mm[:, _UPPER_INNER] - markers_mm[:, _LOWER_INNER]
    parts = (weight * markers_mm, _GAP_WEIGHT * gaps_mm)
    return np.concatenate([part.reshape(len(markers_mm), -1) for part in parts], axis=1)


def _jacobian(face: SimulatedFace, positions_deg: Array, features: Array) -> Array:
    """(n, 150, n_servos): change of the features by degree, as forward differences."""
    columns = []
    for step in _DIFFERENCE_DEG * np.eye(positions_deg.shape[1]):
        moved = _features(marker_positions_mm(face, positions_deg + step))
        columns.append((moved - features) / _DIFFERENCE_DEG)
    return np.stack(columns, axis=2)
