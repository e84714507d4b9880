"""How head motion goes with a voice: canonical correlation, lag, power spectra. Offline.

Prosody is (n, 2), pitch and loudness z at 25 Hz; poses are (n, 3) degrees. Each list holds one
array a recording; nothing is computed across their ends.
"""

from collections.abc import Sequence

import numpy as np

from lipservo_lab.learning.learned_expression.expression_model import RATE_HZ
from lipsync.arrays import Array

#: What was heard now and until 160 ms ago: heads follow a voice by 30 ms on average (Fotedar and
#: Ghosh 2017).
_N_LAGS = 5
_MOST_LAG_FRAMES = 10
_LEAST_LAG_FRAMES = -5
#: 1.28 s; clips are 3 s long.
_PSD_FRAMES = 32
_LEAST_POWER = 1e-9


def canonical_correlation(x: Array, y: Array) -> float:
    """The greatest correlation of any mixture of x (n, p) with any of y (n, q); Hotelling 1936."""

    def orthonormal(values: Array) -> Array:
        centred = values - values.mean(axis=0)
        u, s, _ = np.linalg.svd(centred, full_matrices=False)
        kept: Array = u[:, s > 1e-9 * max(1.0, float(s[0]))]
        return kept

    products = orthonormal(x).T @ orthonormal(y)
    return float(np.linalg.svd(products, compute_uv=False)[0]) if products.size else 0.0


def head_correlation(prosody: Sequence[Array], poses: Sequence[Array]) -> float:
    """First canonical correlation of the voice of the last 200 ms with the head's motion.

    Motion: speed, velocity of pitch and its amount.
    """
    x, y = [], []
    for heard, pose in zip(prosody, poses, strict=True):
        x.append(np.concatenate([heard[_N_LAGS - k : len(heard) - k] for k in range(_N_LAGS)], 1))
        y.append(_motion(pose)[_N_LAGS - 1 :])
    return canonical_correlation(np.concatenate(x), np.concatenate(y))


def head_lag_s(prosody: Sequence[Array], poses: Sequence[Array]) -> tuple[float, float]:
    """By how much the head's speed follows loudness, and their correlation there; -0.2 to 0.4 s."""
    best = (0.0, 0.0)
    for lag in range(_LEAST_LAG_FRAMES, _MOST_LAG_FRAMES + 1):
        pairs = [
            _shifted(h[1:, 1], _motion(p)[:, 0], lag) for h, p in zip(prosody, poses, strict=True)
        ]
        loudness = np.concatenate([pair[0] for pair in pairs])
        speed = np.concatenate([pair[1] for pair in pairs])
        r = float(np.corrcoef(loudness, speed)[0, 1])
        if abs(r) > abs(best[1]):
            best = (lag / RATE_HZ, r)
    return best


def log_psd_distance_db(one: Sequence[Array], other: Sequence[Array]) -> float:
    """Root mean square difference of the poses' power spectra, over axes and 0.8 to 12.5 Hz."""
    ratio = np.log10(_power(one)) - np.log10(_power(other))
    return 10.0 * float(np.sqrt(np.mean(np.square(ratio))))


def _motion(pose: Array) -> Array:
    """(n - 1, 3): speed, velocity of pitch, its amount, in degrees a second."""
    velocity = np.diff(pose, axis=0) * RATE_HZ
    speed = np.sqrt(np.square(velocity).sum(axis=1))
    return np.stack((speed, velocity[:, 0], np.abs(velocity[:, 0])), axis=1)


def _shifted(first: Array, second: Array, lag: int) -> tuple[Array, Array]:
    """The pairs (first[i], second[i + lag])."""
    if lag >= 0:
        return first[: len(first) - lag], second[lag:]
    return first[-lag:], second[:lag]


def _power(poses: Sequence[Array]) -> Array:
    """Welch's mean periodogram (16, 3), means taken away, Hann windows half over one another."""
    window = np.hanning(_PSD_FRAMES)[:, None]
    found = []
    for pose in poses:
        for start in range(0, len(pose) - _PSD_FRAMES + 1, _PSD_FRAMES // 2):
            piece = pose[start : start + _PSD_FRAMES]
            spectrum = np.fft.rfft((piece - piece.mean(axis=0)) * window, axis=0)[1:]
            found.append(np.square(np.abs(spectrum)))
    power: Array = np.mean(found, axis=0)
    return power + _LEAST_POWER
