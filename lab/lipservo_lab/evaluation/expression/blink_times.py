"""Blinks found in the track of a lid, and how often they come."""

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array, Indices
from lipsync.expression.cue import CUE_PERIOD_S

#: A lid that is more than half shut blinks: a gaze down takes it to half at most.
_SHUT = 0.66


def blink_cues(lid: Array) -> Indices:
    """The cues at which a lid (n,) passes two thirds on its way to shut."""
    is_shut = lid > _SHUT
    return np.flatnonzero(is_shut[1:] & ~is_shut[:-1]) + 1


def blinks_per_min(lid: Array, counts: NDArray[np.bool_]) -> float:
    """Blinks a minute among the cues that count (n,); NaN where none does."""
    if not counts.any():
        return float("nan")
    minutes = float(counts.sum()) * CUE_PERIOD_S / 60.0
    return float(counts[blink_cues(lid)].sum()) / minutes


def blink_intervals_s(lid: Array) -> Array:
    """From the beginning of each blink to that of the next, seconds."""
    return np.diff(blink_cues(lid)) * CUE_PERIOD_S
