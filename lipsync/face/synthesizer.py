"""What every synthesiser of mouth motion is to those who drive it."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lipsync.phonemes import PhonemeEvent, PhonemeUpdate

Array = NDArray[np.float64]


class Synthesizer(Protocol):
    """Phonemes in, faces out: ours or the paper's."""

    phonemes_planned: int

    @property
    def lookahead_s(self) -> float:
        """How much sound after an instant must have been heard before its face is asked for."""

    def push(self, update: PhonemeUpdate) -> None:
        """Believe a recogniser; what has been shown stays as it is."""

    def coefficients_at(self, time_s: float) -> Array:
        """The face (n_components,) at a sound time; the same time gives the same face."""

    def event_at(self, time_s: float) -> PhonemeEvent | None:
        """The phoneme believed at a time, for displays."""
