"""The learned expectation of the mouth given context: a few small networks, averaged.

Inference only, NumPy only. Every network has two hidden layers of rectifiers. Phonemes enter by
table look-up (a row for each slot and phoneme, the first layer already applied to what the phoneme
is), so a frame costs a few matrix-vector products.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lipsync.expectation.context import SLOTS, UNKNOWN
from lipsync.phonemes import PHONEMES

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

#: Times are capped here, s: since the starts of the phone before last, the last, this one; until
#: the ends of this one, the next, the one after. 95 % of the phones of grid_s1 are shorter than
#: half of it; a longer memory only tells sentences apart.
_LONGEST_S = np.array([0.5, 0.4, 0.3, 0.25, 0.3, 0.3])
#: How fast an end that comes near makes itself felt, s: the last frame, and the last few.
_NEAR_S = (0.04, 0.1)
#: The unit of the look-ahead feature.
_LOOKAHEAD_UNIT_S = 0.1
N_TIMING = 6 + 3 + 2 + 3 * len(_NEAR_S) + 3 + 1


def timing_features(times_s: Array, lookahead_s: Array) -> Array:
    """What the times of a context mean, between 0 and about 1; (n, 6), (n,) -> (n, N_TIMING)."""
    known = ~np.isnan(times_s)
    share = np.where(known, np.clip(times_s, 0.0, _LONGEST_S), 0.0) / _LONGEST_S
    ends_s = np.where(known[:, 3:], times_s[:, 3:], np.inf)
    starts_s = np.where(known[:, :3], times_s[:, :3], np.inf)
    near = [np.exp(-ends_s / unit_s) for unit_s in _NEAR_S]
    fresh = np.exp(-starts_s / _NEAR_S[1])
    lookahead = lookahead_s[:, None] / _LOOKAHEAD_UNIT_S
    features = np.concatenate(
        [share, known[:, 3:], np.sqrt(share[:, 2:4]), *near, fresh, lookahead], axis=1
    )
    return np.asarray(features, dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Expectation:
    """m networks with h1 and h2 hidden units; what they say is averaged.

    tables: (SLOTS, 41, m h1), the first layer for each slot and phoneme, the last row for UNKNOWN;
    timing: (N_TIMING + 1, m h1), the first layer for the timing features, and its bias;
    hidden: (m, h1 + 1, h2), the second layer, its bias in the last row;
    output: (m h2 + 1, n_components), the last layer and the mean bias, already divided by m.
    """

    tables: Array
    timing: Array
    hidden: Array
    output: Array

    def at(self, phonemes: list[int], times_s: list[float], lookahead_s: float) -> Array:
        """The expected face (n_components,) in one context."""
        return self.faces(np.array([phonemes]), np.array([times_s]), np.array([lookahead_s]))[0]

    def faces(self, phonemes: Indices, times_s: Array, lookahead_s: Array) -> Array:
        """Expected faces (n, n_components) in contexts: (n, 5), (n, 6), (n,)."""
        first = timing_features(times_s, lookahead_s) @ self.timing[:-1] + self.timing[-1]
        for slot in range(SLOTS):
            first += self.tables[slot, phonemes[:, slot]]
        np.maximum(first, 0.0, out=first)
        n_networks, n_first = len(self.hidden), self.hidden.shape[1] - 1
        grouped = first.reshape(len(first), n_networks, n_first).transpose(1, 0, 2)
        second = np.matmul(grouped, self.hidden[:, :-1]) + self.hidden[:, -1:]
        np.maximum(second, 0.0, out=second)
        joined = second.transpose(1, 0, 2).reshape(len(first), -1)
        return np.asarray(joined @ self.output[:-1] + self.output[-1])

    def check(self, n_components: int) -> None:
        """Raises ValueError unless the arrays fit together and are finite."""
        n_networks, n_inputs, n_second = self.hidden.shape
        width = n_networks * (n_inputs - 1)
        shapes = {
            "tables": (self.tables.shape, (SLOTS, UNKNOWN + 1, width)),
            "timing": (self.timing.shape, (N_TIMING + 1, width)),
            "output": (self.output.shape, (n_networks * n_second + 1, n_components)),
        }
        for field, (found, expected) in shapes.items():
            if found != expected:
                raise ValueError(f"expectation {field} has shape {found}, expected {expected}")
            if not np.isfinite(getattr(self, field)).all():
                raise ValueError(f"expectation {field} holds values that are not finite")


def constant_expectation(faces: Array) -> Expectation:
    """One that knows only the phoneme going on; faces (40, n_components), a row for each phoneme.

    For corpora too small to learn from. Exact: each phoneme has two rectifiers a component.
    """
    n_components = faces.shape[1]
    width = 2 * n_components
    tables = np.zeros((SLOTS, UNKNOWN + 1, width))
    tables[2, : len(PHONEMES)] = np.concatenate([faces, -faces], axis=1)
    hidden = np.concatenate([np.eye(width), np.zeros((1, width))])[None]
    output = np.concatenate([np.eye(n_components), -np.eye(n_components)])
    return Expectation(
        tables,
        np.zeros((N_TIMING + 1, width)),
        hidden,
        np.concatenate([output, np.zeros((1, n_components))]),
    )
