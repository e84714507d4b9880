"""Which servo angles bring a face nearest to wanted shapes: bounded least squares, many at once."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from calibration.coupling_rule import CouplingRule
from lipsync.arrays import Array

#: (n, n_servos) degrees -> (n, n_markers, 3) millimetres.
MarkersOf = Callable[[Array], Array]

#: Weights of a millimetre: lips are looked at, cheeks and chin only help; whether lips touch shows
#: most, so the lip gaps count on top of the lips themselves.
_LIP_WEIGHT, _SKIN_WEIGHT, _GAP_WEIGHT = 1.0, 0.3, 4.0
#: Millimetres a degree away from neutral is worth: decides between poses that look the same. From
#: 0.005 to 0.05 no error on grid_s1 changes by 0.005 mm.
NEUTRAL_WEIGHT_MM_PER_DEG = 0.02
#: A millimetre for each degree by which a coupling rule is broken: more than the lips weigh.
_RULE_WEIGHT_MM_PER_DEG = 5.0
#: Enough for angles within 0.001 degree of where they would end, measured on grid_s1.
_ROUNDS = 4
_SWEEPS = 60
_DIFFERENCE_DEG = 0.5


@dataclass(frozen=True, slots=True)
class ShapeFeatures:
    """What counts of a shape. lips: indices of lip markers; gaps: (n_gaps, 2), upper and lower."""

    lips: tuple[int, ...]
    gaps: tuple[tuple[int, int], ...]

    def of(self, markers_mm: Array, gaps_mm: Array | None = None) -> Array:
        """(n, n_markers, 3) -> (n, n_features): weighted positions, then weighted lip gaps.

        gaps_mm: (n, n_gaps, 3), where other gaps are wanted than those of the markers.
        """
        weight = np.full((markers_mm.shape[1], 1), _SKIN_WEIGHT)
        weight[list(self.lips)] = _LIP_WEIGHT
        if gaps_mm is None:
            gaps_mm = self.gaps_mm(markers_mm)
        parts = (weight * markers_mm, _GAP_WEIGHT * gaps_mm)
        return np.concatenate([part.reshape(len(markers_mm), -1) for part in parts], axis=1)

    def gaps_mm(self, markers_mm: Array) -> Array:
        """(n, n_markers, 3) -> (n, n_gaps, 3): upper minus lower."""
        upper, lower = ([pair[i] for pair in self.gaps] for i in (0, 1))
        return np.asarray(markers_mm[:, upper] - markers_mm[:, lower])


def nearest_poses_deg(
    markers_of: MarkersOf,
    wanted: Array,
    shape_features: ShapeFeatures,
    limits_deg: tuple[Array, Array],
    *,
    rules: Sequence[CouplingRule] = (),
    steady_mm_per_deg: float = 0.0,
) -> Array:
    """Features (n, n_features) of shapes -> (n, n_servos) within the limits, keeping the rules.

    Gauss-Newton from neutral. steady_mm_per_deg: what a degree of difference to the neighbouring
    frames costs, where the n frames follow one another.
    """
    n_servos = len(limits_deg[0])
    angles_deg = np.zeros((len(wanted), n_servos))
    for _ in range(_ROUNDS):
        reached = shape_features.of(markers_of(angles_deg))
        slopes = shape_slopes(markers_of, shape_features, angles_deg, reached)
        missing = wanted - reached + np.einsum("nks,ns->nk", slopes, angles_deg)
        cost = np.einsum("nks,nkt->nst", slopes, slopes)
        cost += NEUTRAL_WEIGHT_MM_PER_DEG**2 * np.eye(n_servos)
        pull = np.einsum("nks,nk->ns", slopes, missing)
        for rule in rules:
            broken = (angles_deg @ rule.weights > rule.at_most_deg) * _RULE_WEIGHT_MM_PER_DEG**2
            cost += broken[:, None, None] * np.outer(rule.weights, rule.weights)
            pull += broken[:, None] * rule.weights * rule.at_most_deg
        if steady_mm_per_deg:
            padded = np.concatenate([angles_deg[:1], angles_deg, angles_deg[-1:]])
            cost += steady_mm_per_deg**2 * np.eye(n_servos)
            pull += steady_mm_per_deg**2 * (padded[:-2] + padded[2:]) / 2
        angles_deg = bounded_minimum(cost, pull, *limits_deg)
    return angles_deg


def shape_slopes(
    markers_of: MarkersOf, shape_features: ShapeFeatures, angles_deg: Array, reached: Array
) -> Array:
    """(n, n_features, n_servos): change of the features by degree, as forward differences."""
    columns = [
        (shape_features.of(markers_of(angles_deg + step)) - reached) / _DIFFERENCE_DEG
        for step in _DIFFERENCE_DEG * np.eye(angles_deg.shape[1])
    ]
    return np.stack(columns, axis=2)


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
