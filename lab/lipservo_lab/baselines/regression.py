"""One plain linear regression from phoneme context to face: the simplest baseline.

Frame-synchronous: it sees what the live method sees, the five phonemes and six times of a context.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array
from lipsync.expectation.context import SLOTS, UNKNOWN
from lipsync.expectation.expectation import timing_features

Indices = NDArray[np.int64]

#: Ridge in units of frames; any value from 10 to 1000 gives the same ratio to two digits.
_RIDGE = 100.0


@dataclass(frozen=True, slots=True)
class PlainRegression:
    """What each phoneme in each slot, each timing feature, and the constant add to the face.

    weights: (5 * 41 + N_TIMING + 1, n_components).
    """

    weights: Array

    def faces(self, phonemes: Indices, times_s: Array, lookahead_s: Array) -> Array:
        """Faces (n, n_components) in contexts: (n, 5), (n, 6), (n,)."""
        return np.asarray(_inputs(phonemes, times_s, lookahead_s) @ self.weights)


def fit_regression(
    phonemes: Indices, times_s: Array, lookahead_s: Array, faces: Array
) -> PlainRegression:
    """Least squares with a little ridge; (n, 5), (n, 6), (n,) and (n, n_components)."""
    inputs = _inputs(phonemes, times_s, lookahead_s)
    gram = inputs.T @ inputs + _RIDGE * np.eye(inputs.shape[1])
    return PlainRegression(np.asarray(np.linalg.solve(gram, inputs.T @ faces), dtype=np.float64))


def _inputs(phonemes: Indices, times_s: Array, lookahead_s: Array) -> Array:
    names = np.zeros((len(phonemes), SLOTS, UNKNOWN + 1))
    np.put_along_axis(names, phonemes[:, :, None], 1.0, axis=2)
    timing = timing_features(times_s, lookahead_s)
    return np.concatenate(
        [names.reshape(len(phonemes), -1), timing, np.ones((len(phonemes), 1))], axis=1
    )
