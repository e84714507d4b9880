"""Back-off of the expectation (predicted mean motion of the mouth) to a fixed method.

It is used for diphones, pairs of phonemes in sequence, that training did not have. After Cohen and
Massaro, "Modeling coarticulation in synthetic visual speech", 1993: every phone pulls at the face,
the stronger the nearer; as far as the phones of a context are known.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array
from lipsync.phonemes import PHONEMES, SILENCE

#: The fixed method's share where a diphone is new, by inner splits (docs/decisions/motion.md).
BACK_OFF_SHARE: Final = 0.2
#: A phone pulls with exp(-(24 |tau|)^1.4), tau in s from its centre: the benchmarks' reference.
_RATE_PER_S, _POWER = 24.0, 1.4
_SILENCE: Final = PHONEMES.index(SILENCE)


@dataclass(frozen=True, slots=True)
class BackOff:
    """The data of the fixed method, and which phonemes followed each other in training.

    centres: (40, n_components), the mean face in the middle of each phoneme. diphones: (41, 41),
    whether the second phoneme followed the first in training; the last row and column are for
    UNKNOWN, and True.
    """

    centres: Array
    diphones: NDArray[np.bool_]

    def share(self, phonemes: list[int]) -> float:
        """Return the fixed method's share in a context of five phonemes.

        It is 0.2 where the present phoneme never followed the one before in training, else 0.
        """
        return 0.0 if self.diphones[phonemes[1], phonemes[2]] else BACK_OFF_SHARE

    def mixed(
        self, face: Array, phonemes: list[int], times_s: list[float], known_s: float
    ) -> Array:
        """Return an expected face, moved by `share` towards the fixed method's face.

        Parameters
        ----------
        face : Array
            (n_components,), expected by the networks.
        phonemes : list[int]
            5 phoneme indices of `context_at`.
        times_s : list[float]
            6 times of `context_at`, NaN: not known.
        known_s : float
            Seconds known beyond the instant; an end that is not known counts as this.

        Returns
        -------
        Array
            (n_components,) face coefficients; `face` itself where the share is 0.
        """
        share = self.share(phonemes)
        return face + share * (self._fixed(phonemes, times_s, known_s) - face) if share else face

    def _fixed(self, phonemes: list[int], times_s: list[float], known_s: float) -> Array:
        """Return the face (n_components,) of the fixed method in a context, as `mixed` gets it.

        It is the mean of the `centres` of the context's phonemes, weighted by their pulls.
        """
        ends_s = [known_s if math.isnan(end_s) else end_s for end_s in times_s[3:]]
        borders_s = [*(-since_s for since_s in times_s[:3]), *ends_s]
        rows, exponents = [], []
        for phoneme, start_s, end_s in zip(phonemes, borders_s[:-1], borders_s[1:], strict=True):
            if phoneme < len(PHONEMES):
                # A silence is as near as its nearer end, any other phone as its middle.
                from_edge_s = max(start_s, -end_s, 0.0)
                tau_s = from_edge_s if phoneme == _SILENCE else abs(start_s + end_s) / 2.0
                rows.append(phoneme)
                exponents.append((_RATE_PER_S * tau_s) ** _POWER)
        # The nearest phone pulls with 1, or in a phone held for long every pull would vanish.
        pulls = np.exp(min(exponents) - np.array(exponents))
        return np.asarray(pulls @ self.centres[rows] / pulls.sum())
