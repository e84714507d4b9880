"""The pose of a true robot that is nearest to a shape, to convergence.

Lips that stop each other make a robot's shape bend sharply at contact, where plain Gauss-Newton
goes to and fro; here each step is damped until it helps (Levenberg-Marquardt: More, The
Levenberg-Marquardt algorithm, 1978), and shortened by the joints' limits.
"""

from dataclasses import dataclass

import numpy as np

from calibration.run.inverse import (
    NEUTRAL_WEIGHT_MM_PER_DEG,
    MarkersOf,
    ShapeFeatures,
    bounded_minimum,
    shape_slopes,
)
from lipsync.arrays import Array

#: Robots of seeds 103, 105 and 106: three beginnings end within 0.06 mm of one another.
_ROUNDS = 30
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1.0, 1e-3, 1e6
_EASED, _HARDENED = 1.0 / 3.0, 4.0


@dataclass(frozen=True, slots=True)
class _Tried:
    """Poses (n, n_servos), the features they show, and what these cost, (n,)."""

    poses_deg: Array
    shown: Array
    cost: Array

    def better_of(self, other: "_Tried") -> "_Tried":
        """The cheaper of the two, frame by frame."""
        ours = (self.cost <= other.cost)[:, None]
        return _Tried(
            np.where(ours, self.poses_deg, other.poses_deg),
            np.where(ours, self.shown, other.shown),
            np.minimum(self.cost, other.cost),
        )


def converged_poses_deg(
    markers_of: MarkersOf,
    wanted: Array,
    shape_features: ShapeFeatures,
    limits_deg: tuple[Array, Array],
) -> Array:
    """Features (n, n_features) of shapes -> (n, n_servos), from neutral.

    What is minimised is what `nearest_poses_deg` minimises.
    """

    def tried(poses_deg: Array) -> _Tried:
        shown = shape_features.of(markers_of(poses_deg))
        apart = np.sum((shown - wanted) ** 2, axis=1)
        turned = NEUTRAL_WEIGHT_MM_PER_DEG**2 * np.sum(poses_deg**2, axis=1)
        return _Tried(poses_deg, shown, apart + turned)

    n_servos = len(limits_deg[0])
    best = tried(np.zeros((len(wanted), n_servos)))
    damping = np.full(len(wanted), _FIRST_DAMPING)
    for _ in range(_ROUNDS):
        by_deg = shape_slopes(markers_of, shape_features, best.poses_deg, best.shown)
        bends = np.einsum("nks,nkt->nst", by_deg, by_deg)
        bends += (NEUTRAL_WEIGHT_MM_PER_DEG**2 + damping[:, None, None]) * np.eye(n_servos)
        pull = np.einsum("nks,nk->ns", by_deg, wanted - best.shown)
        pull -= NEUTRAL_WEIGHT_MM_PER_DEG**2 * best.poses_deg
        pull += np.einsum("nst,nt->ns", bends, best.poses_deg)
        step = tried(bounded_minimum(bends, pull, *limits_deg))
        helped = step.cost < best.cost
        best = best.better_of(step)
        damping *= np.where(helped, _EASED, _HARDENED)
        damping = np.clip(damping, _LEAST_DAMPING, _MOST_DAMPING)
    return best.poses_deg
