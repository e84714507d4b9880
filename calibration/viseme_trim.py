"""Degrees that a person adds to a joint while a viseme class is spoken, without training anew."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from lipsync.phonemes import VISEME_CLASSES, VISEME_OF

Array = NDArray[np.float64]

#: Trims come and go with this time constant: within a phone of 80 ms, without a step that the
#: servos would make audible.
_BLEND_S = 0.03


class VisemeTrim:
    """Streaming: `feed` a phoneme each `period_s`, get the degrees to add. NumPy only."""

    def __init__(self, trim: Mapping[str, Array], n_servos: int, period_s: float) -> None:
        """trim: degrees (n_servos,) by the first phoneme of a viseme class, as in the file."""
        self._nothing = np.zeros(n_servos)
        self._wanted = [trim.get(viseme[0], self._nothing) for viseme in VISEME_CLASSES]
        self._share = 1.0 - np.exp(-period_s / _BLEND_S)
        self._idle = not trim
        self._added_deg = self._nothing

    def feed(self, phoneme: str) -> Array:
        """(n_servos,): what to add for this period."""
        if not self._idle:
            wanted = self._wanted[VISEME_OF[phoneme]]
            self._added_deg = self._added_deg + self._share * (wanted - self._added_deg)
        return self._added_deg

    def reset(self) -> None:
        """Start anew without any trim."""
        self._added_deg = self._nothing
