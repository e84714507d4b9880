"""A stretch of motion between two times, defined by samples and their derivatives."""

from dataclasses import dataclass

import numpy as np

from lipsync.arrays import Array

#: Two sums of the same times differ by less than this; a joint is not past the end.
_ROUNDING_S = 1e-9


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Cubic Hermite curve through evenly spaced samples; it rests at its last one afterwards.

    samples, derivatives: (n, n_components), derivatives per sample spacing; n >= 2.
    """

    start_s: float
    duration_s: float
    samples: Array
    derivatives: Array

    @property
    def end_s(self) -> float:
        """Time of the last sample."""
        return self.start_s + self.duration_s

    @property
    def spacing_s(self) -> float:
        """Time between two samples."""
        return self.duration_s / (len(self.samples) - 1)

    def at(self, time_s: float) -> tuple[Array, Array]:
        """Position and derivative per second, each (n_components,), at a time >= start_s.

        Wei and Deng, Algorithm 1. Past the end: the last sample at rest.
        """
        if time_s > self.end_s + _ROUNDING_S:
            return self.samples[-1], np.zeros_like(self.samples[-1])
        u = max(0.0, (time_s - self.start_s) / self.spacing_s)
        i = min(int(u), len(self.samples) - 2)
        u -= i
        p, q = self.samples[i], self.samples[i + 1]
        d, e = self.derivatives[i], self.derivatives[i + 1]
        position = (
            (1 + 2 * u) * (1 - u) ** 2 * p
            + u * (1 - u) ** 2 * d
            + u**2 * (3 - 2 * u) * q
            + u**2 * (u - 1) * e
        )
        derivative = 6 * u * (u - 1) * (p - q) + (1 - u) * (1 - 3 * u) * d + u * (3 * u - 2) * e
        return position, derivative / self.spacing_s


def ease(
    start_s: float, duration_s: float, position: Array, velocity: Array, to: Array
) -> Trajectory:
    """From a position moving at `velocity` per second to rest at `to`; all (n_components,)."""
    return Trajectory(
        start_s,
        duration_s,
        np.stack([position, to]),
        np.stack([velocity * duration_s, np.zeros_like(to)]),
    )
