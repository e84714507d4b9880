"""Functions that join an AnimPho's samples to the motion so far, and the curve through the samples.

An AnimPho is a recorded piece of mouth motion, of five samples. They are numbered 1..5 as in the
paper in the formulas, 0..4 in the code.
"""

from dataclasses import dataclass

import numpy as np

from lipsync.animpho.units import SAMPLES_PER_ANIMPHO, AnimPhoUnits
from lipsync.arrays import Array


def choose_connected(units: AnimPhoUnits, previous: int, chosen: int) -> int:
    """Return the index of the recorded piece that follows `previous` and moves most like `chosen`.

    Wei and Deng, eq. (3): b_t, of the AnimPhos that follow a_{t-1} (`previous`) in training, for
    a_t (`chosen`). It is a_t itself when that follows a_{t-1}, or when no AnimPho does: a_{t-1} was
    the last one of a sentence.
    """
    followers = units.successors[previous]
    if len(followers) == 0 or chosen in followers:
        return chosen
    difference = units.samples[followers] - units.samples[chosen]
    return int(followers[np.argmin((difference**2).sum(axis=(1, 2)))])


def translate(animpho: Array, start: Array) -> Array:
    """Return a recorded piece of motion moved to begin at `start`: b'_t of Wei and Deng.

    Parameters
    ----------
    animpho : Array
        (5, n_components) samples of the recorded piece.
    start : Array
        (n_components,) position.

    Returns
    -------
    Array
        (5, n_components) moved samples.
    """
    return np.asarray(animpho + (start - animpho[0]))


def remainder_weights(share: float) -> Array:
    """Return weights that resample the rest of a recorded piece at five times.

    Parameters
    ----------
    share : float
        Fraction of the piece that has passed, 0 to below 1.

    Returns
    -------
    Array
        (5, 5): each row holds one new sample's weights on the piece's five samples.
    """
    positions = np.linspace(share, 1.0, SAMPLES_PER_ANIMPHO) * (SAMPLES_PER_ANIMPHO - 1)
    # Linear interpolation: the two samples around a position share it by nearness.
    return np.maximum(0.0, 1.0 - np.abs(positions[:, None] - np.arange(SAMPLES_PER_ANIMPHO)))


def blend(connected: Array, chosen: Array, joined_share: float = 1.0) -> Array:
    """Return samples that begin as the AnimPho b'_t and end as a_t: m_t of Wei and Deng, eq. (4).

    Parameters
    ----------
    connected,chosen : Array
        (5, n_components): b'_t and a_t, two recorded pieces of motion.
    joined_share : float
        Above 0 to 1: fraction of m_t after which it equals a_t; the paper's is 1.

    Returns
    -------
    Array
        (5, n_components) samples of m_t.
    """
    weight = np.linspace(0.0, 1.0, SAMPLES_PER_ANIMPHO)[:, None]
    weight = np.minimum(1.0, weight / joined_share)
    return (1.0 - weight) * connected + weight * chosen


def sample_derivatives(samples: Array, first: Array) -> Array:
    """Return the derivatives d_t at the samples, per sample spacing. Wei and Deng, eq. (5).

    Parameters
    ----------
    samples : Array
        (5, n_components) samples.
    first : Array
        (n_components,), derivative at the first sample, carried over from the motion before.

    Returns
    -------
    Array
        (5, n_components) derivatives.
    """
    derivatives = np.empty_like(samples)
    derivatives[0] = first
    derivatives[1:-1] = (samples[2:] - samples[:-2]) / 2.0
    derivatives[-1] = samples[-1] - samples[-2]
    return derivatives


#: Two sums of the same times differ by less than this; a joint is not past the end.
_ROUNDING_S = 1e-9


@dataclass(frozen=True, slots=True)
class Trajectory:
    """Cubic Hermite curve through evenly spaced samples; after its end it rests at the last sample.

    start_s: sound time of the first sample; duration_s: from there to the last. samples,
    derivatives: (n, n_components), derivatives per sample spacing; n >= 2.
    """

    start_s: float
    duration_s: float
    samples: Array
    derivatives: Array

    @property
    def end_s(self) -> float:
        """Sound time of the last sample, in seconds."""
        return self.start_s + self.duration_s

    @property
    def spacing_s(self) -> float:
        """Seconds between two samples."""
        return self.duration_s / (len(self.samples) - 1)

    def at(self, time_s: float) -> tuple[Array, Array]:
        """Return position and speed of the curve at a sound time. Wei and Deng, Algorithm 1.

        Parameters
        ----------
        time_s : float
            Sound time, at least start_s; past the end, the last sample at rest is returned.

        Returns
        -------
        tuple[Array, Array]
            Position (n_components,), and derivative (n_components,) per second.
        """
        if time_s > self.end_s + _ROUNDING_S:
            return self.samples[-1], np.zeros_like(self.samples[-1])
        u = max(0.0, (time_s - self.start_s) / self.spacing_s)
        # Hermite's cubic between the samples i and i + 1, at the share u of the way.
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
    start_s: float, duration_s: float, position: Array, velocity: Array, goal: Array
) -> Trajectory:
    """Return the trajectory that brings a moving mouth smoothly from `position` to rest at `goal`.

    Parameters
    ----------
    start_s,duration_s : float
        Start and length in seconds.
    position,goal : Array
        (n_components,) first and last position.
    velocity : Array
        (n_components,) per second, at the start.

    Returns
    -------
    Trajectory
        From `position` to `goal`, at rest after `duration_s` seconds.
    """
    return Trajectory(
        start_s,
        duration_s,
        np.stack([position, goal]),
        np.stack([velocity * duration_s, np.zeros_like(goal)]),
    )
