"""Stored units, and which of them sound most like a stretch of a new line.

Edge, Hilton and Jackson, step 2 of synthesis. A unit runs from the centre of the phone before to
the centre of the phone after, and is classified by the phone in its middle alone. Dynamic time
warping is dtaidistance's.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from lipsync.arrays import Array, Indices
from lipsync.phonemes import PhonemeEvent


@dataclass(frozen=True, slots=True)
class Spans:
    """Units of one recording: the frames first_i <= f < end_i of each phone, and its centre."""

    phonemes: tuple[str, ...]
    first: Indices
    end: Indices
    centres_s: Array

    def neighbours(self, n_frames: int, frame_rate_hz: float) -> tuple[Indices, Indices]:
        """For each frame the unit whose phone has its centre before, and the one after.

        Frames before the first centre, or after the last one, lie in one unit only: it is both.
        """
        times_s = np.arange(n_frames) / frame_rate_hz
        right = np.searchsorted(self.centres_s, times_s + 1e-9)
        last = len(self.phonemes) - 1
        return np.clip(right - 1, 0, last), np.clip(right, 0, last)


def unit_spans(events: Sequence[PhonemeEvent], n_frames: int, frame_rate_hz: float) -> Spans:
    """The units of phones that follow each other without gaps, each with its end.

    The first begins with the recording, the last ends with it; each has one frame at least.
    """
    duration_s = n_frames / frame_rate_hz
    ends_s = [duration_s if e.end_s is None else e.end_s for e in events]
    centres_s = np.array([(e.start_s + end) / 2.0 for e, end in zip(events, ends_s, strict=True)])
    borders = np.ceil(centres_s * frame_rate_hz - 1e-6).astype(np.int64)
    first = np.concatenate([[0], borders[:-1]])
    end = np.concatenate([borders[1:], [n_frames]])
    first = np.clip(first, 0, n_frames - 1)
    return Spans(
        tuple(e.phoneme for e in events), first, np.clip(end, first + 1, n_frames), centres_s
    )


def warped_distances(target: Array, stored: Sequence[Array]) -> Array:
    """How unlike each of the stored units (n_j, m) sounds to the target (n, m): (n_units,).

    P(i, j) = d(i, j) + min(P(i-1, j), P(i-1, j-1), P(i, j-1)), equation (1), with d the Euclidean
    distance of cepstra; the cost of a unit is P at the ends of both. Needs the extra `offline`.
    """
    from dtaidistance.dtw_cc import distance_ndim  # the published method alone needs it

    target = np.ascontiguousarray(target, dtype=np.float64)
    return np.array([distance_ndim(target, each, inner_dist="euclidean") for each in stored])


def joined_phones(events: Sequence[PhonemeEvent], duration_s: float) -> tuple[PhonemeEvent, ...]:
    """The phones of a line end to end from 0 to its duration: gaps and both ends are silence.

    What begins after the end of the sound is left out, and what goes on beyond it is cut.
    """
    found: list[PhonemeEvent] = []

    def add(phoneme: str, start_s: float, end_s: float) -> None:
        if found and phoneme == "SIL" == found[-1].phoneme:
            found[-1] = PhonemeEvent("SIL", found[-1].start_s, end_s)
        elif end_s > start_s:
            found.append(PhonemeEvent(phoneme, start_s, end_s))

    reached_s = 0.0
    for event in events:
        end_s = duration_s if event.end_s is None else min(event.end_s, duration_s)
        if end_s <= event.start_s:
            continue
        if event.start_s > reached_s:
            add("SIL", reached_s, event.start_s)
        add(event.phoneme, event.start_s, end_s)
        reached_s = end_s
    if reached_s < duration_s:
        add("SIL", reached_s, duration_s)
    return tuple(found)


def frames_between(borders: Indices) -> list[range]:
    """Ranges of frames of recordings that lie end to end: borders (n + 1,)."""
    return [range(int(a), int(b)) for a, b in pairwise(borders)]
