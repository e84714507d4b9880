"""What is known about the phonemes at one instant: the only input of the expectation.

The rule that makes it live: with look-ahead L, at time t a phoneme is known when it begins at or
before t + L, and its end only when it lies at or before t + L.
"""

import math
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array
from lipsync.phonemes import PHONEMES, SILENCE, PhonemeEvent

Indices = NDArray[np.int64]

#: Two phonemes before, the one going on, two after.
SLOTS = 5
#: Stands where no phoneme is, or none is known yet.
UNKNOWN = len(PHONEMES)
_INDEX_OF = {phoneme: index for index, phoneme in enumerate(PHONEMES)}
_SILENCE = _INDEX_OF[SILENCE]
#: Sums of the same times differ by less.
_ROUNDING_S = 1e-9


@dataclass(frozen=True, slots=True)
class PhonemeTrack:
    """Phonemes end to end from minus infinity on: gaps are silence, silences are joined.

    starts_s[0] is minus infinity; ends_s[i] = starts_s[i + 1]; the last end is infinite.
    """

    phonemes: tuple[int, ...]
    starts_s: tuple[float, ...]
    ends_s: tuple[float, ...]


def track_of(events: Iterable[PhonemeEvent]) -> PhonemeTrack:
    """The track of events in order of time that do not overlap."""
    phonemes, starts_s, end_s = [_SILENCE], [-math.inf], -math.inf

    def begin(phoneme: int, start_s: float) -> None:
        if not (phoneme == phonemes[-1] == _SILENCE):
            phonemes.append(phoneme)
            starts_s.append(start_s)

    for event in events:
        if event.start_s > end_s + _ROUNDING_S:
            begin(_SILENCE, end_s)
        begin(_INDEX_OF[event.phoneme], event.start_s)
        end_s = math.inf if event.end_s is None else event.end_s
    if math.isfinite(end_s):
        begin(_SILENCE, end_s)
    return PhonemeTrack(tuple(phonemes), tuple(starts_s), (*starts_s[1:], math.inf))


def context_at(
    track: PhonemeTrack, time_s: float, known_until_s: float
) -> tuple[list[int], list[float]]:
    """The five phonemes around an instant, and six times in seconds, as far as they are known.

    Phonemes: the two before, the one going on, the two after; UNKNOWN where there is none. Times:
    since the beginnings of the first three; until the ends of the last three, NaN where that end
    is not known.
    """
    limit_s = known_until_s + _ROUNDING_S
    at = bisect_right(track.starts_s, min(time_s + _ROUNDING_S, limit_s)) - 1
    phonemes = [track.phonemes[i] if i >= 0 else UNKNOWN for i in (at - 2, at - 1, at)]
    times_s = [time_s - track.starts_s[i] if i >= 0 else math.inf for i in (at - 2, at - 1, at)]
    for i in (at, at + 1, at + 2):
        end_s = track.ends_s[i] if i < len(track.ends_s) else math.inf
        known = end_s <= limit_s
        times_s.append(end_s - time_s if known else math.nan)
        if i < at + 2:
            phonemes.append(track.phonemes[i + 1] if known else UNKNOWN)
        if not known:
            missing = at + 2 - i
            times_s.extend([math.nan] * missing)
            phonemes.extend([UNKNOWN] * (SLOTS - len(phonemes)))
            break
    return phonemes, times_s


def contexts(
    track: PhonemeTrack, times_s: Sequence[float] | Array, lookahead_s: float
) -> tuple[Indices, Array]:
    """`context_at` for many instants: phonemes (n, 5) and times (n, 6)."""
    found = [context_at(track, float(t), float(t) + lookahead_s) for t in times_s]
    phonemes = np.array([p for p, _ in found], dtype=np.int64).reshape(-1, SLOTS)
    return phonemes, np.array([t for _, t in found]).reshape(-1, 6)
