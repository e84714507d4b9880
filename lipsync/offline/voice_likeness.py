"""Whether a line is spoken by the voice that sounds were learned from.

The long-term mean of the cepstra tells voices and microphones apart, whatever is said (Furui, IEEE
Trans. ASSP 29(2), 1981). Normalising takes it away, and what is left of another voice still lies
elsewhere: there distances of sound mean little, and phonemes alone are believed.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array
from lipsync.offline.cepstra import is_heard, plain_cepstra


@dataclass(frozen=True, slots=True)
class VoiceLikeness:
    """mean (m,) and precision (m, m) of the mean cepstrum of a line, over the lines of one voice.

    limit: what is farther off is another voice.
    """

    mean: Array
    precision: Array
    limit: float

    def distance(self, samples: NDArray[np.float32]) -> float:
        """How far a line, (n,) at 16 kHz, is off: the squared Mahalanobis distance over m.

        1 on average for the voice that was learned from.
        """
        off = mean_cepstrum(samples) - self.mean
        return float(off @ self.precision @ off) / len(off)

    def knows(self, samples: NDArray[np.float32]) -> bool:
        """Whether the sound of a line may be believed."""
        return self.distance(samples) <= self.limit


def mean_cepstrum(samples: NDArray[np.float32]) -> Array:
    """(12,), the mean over what is heard in samples (n,) at 16 kHz; the level is left out."""
    found = plain_cepstra(samples)
    return np.asarray(found[is_heard(found), 1:].mean(axis=0))
