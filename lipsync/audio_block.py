"""The block of sound that sources return, and the count of samples before a time."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

#: The sample rate of recognisers; sources of sound resample to it.
SAMPLE_RATE_HZ = 16_000
#: Sources hand sound out in blocks of this length.
BLOCK_S = 0.010


@dataclass(frozen=True, slots=True)
class AudioBlock:
    """Mono sound: samples (n,) float32 in [-1, 1], the first `start_s` after the stream's first."""

    samples: NDArray[np.float32]
    start_s: float
    sample_rate_hz: int = SAMPLE_RATE_HZ

    @property
    def end_s(self) -> float:
        """Sound time in seconds just after the last sample."""
        return self.start_s + len(self.samples) / self.sample_rate_hz


def samples_before(time_s: float, sample_rate_hz: int = SAMPLE_RATE_HZ) -> float:
    """Return how many whole samples end at or before sound time `time_s` (>= 0); inf for inf.

    A thousandth of a sample is tolerated: tick times such as 29 * 0.01 s are rounded binary
    numbers.
    """
    return math.inf if math.isinf(time_s) else math.floor(time_s * sample_rate_hz + 1e-3)
