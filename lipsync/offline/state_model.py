"""What the model-based method knows of a speaker: states, what was heard in them, and units."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array, Indices


@dataclass(frozen=True, slots=True)
class Units:
    """Stored units: frames first_i <= f < end_i of the corpus, by the phone in their middle.

    phonemes: (n,), numbers in PHONEMES; first, end: (n,).
    """

    phonemes: Indices
    first: Indices
    end: Indices

    def of(self, phoneme: int) -> Indices:
        """The numbers of all units of a phoneme."""
        return np.flatnonzero(self.phonemes == phoneme)


@dataclass(frozen=True, slots=True)
class StateModel:
    """All sentences end to end.

    frame_rate_hz: of motion and cepstra.
    borders: (n_sentences + 1,), where each sentence begins, and the end. cepstra: (n, m) float32.
    states: (n,), of each frame. units: over the same frames.
    follows: (n_states, n_states), T of equation (S2). means (n_states, 2 p) and covariances
    (n_states, 2 p, 2 p): of positions and speeds (per frame) in the components of its own.
    mean_mm (n_coordinates,) and basis (p, n_coordinates): those components.
    """

    frame_rate_hz: float
    borders: Indices
    cepstra: NDArray[np.float32]
    states: Indices
    units: Units
    follows: NDArray[np.bool_]
    means: Array
    covariances: Array
    mean_mm: Array
    basis: Array

    @property
    def n_states(self) -> int:
        """How many states there are."""
        return len(self.means)

    @property
    def n_components(self) -> int:
        """Of its own basis, p."""
        return len(self.basis)

    def sentence_of(self, frame: int) -> tuple[int, int]:
        """The first frame of the sentence that a frame lies in, and the one after its last."""
        at = int(np.searchsorted(self.borders, frame, side="right")) - 1
        return int(self.borders[at]), int(self.borders[at + 1])
