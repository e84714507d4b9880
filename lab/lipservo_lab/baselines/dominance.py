"""Dominance functions: every phone pulls at the face, the stronger the nearer.

After Cohen and Massaro, "Modeling coarticulation in synthetic visual speech", 1993. A baseline; it
sees the whole sentence.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lipsync.arrays import Array
from lipsync.phonemes import PHONEMES, SILENCE, VISEME_CLASSES, VISEME_OF, PhonemeEvent

#: The fixed reference of every ratio, never retuned: D = exp(-(24 |tau|)^1.4).
REFERENCE_RATE_PER_S, REFERENCE_POWER = 24.0, 1.4
_TINY = 1e-300


@dataclass(frozen=True, slots=True)
class Dominance:
    """D = exp(-(rate |tau|)^power), per viseme class and direction.

    rates_per_s, powers: (16, 2), a row for each of VISEME_CLASSES; first column before the phone's
    centre, second after it. tau: seconds from the centre; from the edge for silence, 0 inside.
    """

    rates_per_s: Array
    powers: Array

    def face_at(self, phones: Sequence[PhonemeEvent], centres: Array, times_s: Array) -> Array:
        """(n, n_components) for a whole sentence; centres: (40, n_components), the targets."""
        log_weights = -self.exponents(phones, times_s)
        # The nearest phone gets weight 1, or far from all of them every weight would vanish.
        weights = np.exp(log_weights - log_weights.max(axis=1, keepdims=True))
        targets = centres[[PHONEMES.index(p.phoneme) for p in phones]]
        return np.asarray(weights @ targets / weights.sum(axis=1, keepdims=True))

    def exponents(self, phones: Sequence[PhonemeEvent], times_s: Array) -> Array:
        """(n, n_phones): (rate |tau|)^power."""
        classes = [VISEME_OF[p.phoneme] for p in phones]
        tau_s = distances_s(phones, times_s)
        after = (tau_s > 0.0).astype(np.intp)
        rate, power = self.rates_per_s[classes, after], self.powers[classes, after]
        return np.asarray(np.maximum(rate * np.abs(tau_s), _TINY) ** power)


def distances_s(phones: Sequence[PhonemeEvent], times_s: Array) -> Array:
    """Tau (n, n_phones): negative before a phone's centre, positive after it."""
    starts_s = np.array([p.start_s for p in phones])
    ends_s = np.array([np.inf if p.end_s is None else p.end_s for p in phones])
    silent = np.array([p.phoneme == SILENCE for p in phones])
    centre_s = np.where(silent, 0.0, (starts_s + ends_s) / 2.0)
    t = np.asarray(times_s)[:, None]
    from_edge = np.where(t < starts_s, t - starts_s, np.maximum(t - ends_s, 0.0))
    return np.asarray(np.where(silent, from_edge, t - centre_s))


def fixed_reference() -> Dominance:
    """The denominator of every ratio (motion-quality: 1.80 mm on random splits of grid_s1)."""
    shape = (len(VISEME_CLASSES), 2)
    return Dominance(np.full(shape, REFERENCE_RATE_PER_S), np.full(shape, REFERENCE_POWER))
