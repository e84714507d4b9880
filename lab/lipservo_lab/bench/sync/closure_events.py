"""When lips close and part, against when the sound says that they do."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from lipsync.arrays import Array
from lipsync.markers import CLOSED_GAP_MM
from lipsync.motion.closure_plan import BILABIALS
from lipsync.phonemes import SILENCE
from lipsync.text_to_speech.spoken_text import SpokenText

#: An event belongs to the nearest of its kind within this time.
MATCHED_S: Final = 0.200
#: Of full scale; a synthesiser's closures are silent to the last bit or two.
_SILENT: Final = 0.002
_LEAST_CLOSURE_S: Final = 0.010


@dataclass(frozen=True, slots=True)
class Crossings:
    """Seconds, in order: when lips close and when they part."""

    closing_s: Array
    parting_s: Array


def sounding_closures(text: SpokenText) -> Crossings:
    """What the sound asks for: closed from the onset of each P, B, M to its release.

    The release is where the closure's silence ends, at the burst; without silence the end of the
    phoneme. Neighbours among them are one closure. Beside a silence lips may rest closed: there
    nothing is asked for.
    """
    phonemes = text.phonemes
    closing_s: list[float] = []
    parting_s: list[float] = []
    before = SILENCE
    following = [*(each.phoneme for each in phonemes[1:]), SILENCE]
    for event, after in zip(phonemes, following, strict=True):
        if event.phoneme in BILABIALS:
            if before not in (*BILABIALS, SILENCE):
                closing_s.append(event.start_s)
            if after not in (*BILABIALS, SILENCE) and event.end_s is not None:
                parting_s.append(_release_s(text, event.start_s, event.end_s))
        before = event.phoneme
    return Crossings(np.array(closing_s), np.array(parting_s))


def _release_s(text: SpokenText, start_s: float, end_s: float) -> float:
    first = round(start_s * text.sample_rate_hz)
    sounds = np.abs(text.samples[first : round(end_s * text.sample_rate_hz)]) >= _SILENT
    # The longest stretch without sound: from one sample that sounds to the next.
    places = np.concatenate(([-1], np.flatnonzero(sounds)))
    gaps = np.diff(places)
    if len(gaps) == 0 or gaps.max() < _LEAST_CLOSURE_S * text.sample_rate_hz:
        return end_s
    return start_s + float(places[int(gaps.argmax()) + 1]) / text.sample_rate_hz


def seen_closures(times_s: Array, gap_mm: Array, closed_mm: float = CLOSED_GAP_MM) -> Crossings:
    """What lips did: crossings of closed_mm, between samples by a straight line.

    times_s, gap_mm: (n,).
    """
    closed = gap_mm < closed_mm
    changed = np.flatnonzero(closed[1:] != closed[:-1])
    share = (closed_mm - gap_mm[changed]) / (gap_mm[changed + 1] - gap_mm[changed])
    at_s = times_s[changed] + share * (times_s[changed + 1] - times_s[changed])
    return Crossings(at_s[closed[changed + 1]], at_s[~closed[changed + 1]])


def matched_errors_s(asked_s: Array, seen_s: Array) -> tuple[Array, int]:
    """How much later each asked-for event was seen, (n_matched,), and how many were not at all."""
    if len(seen_s) == 0 or len(asked_s) == 0:
        return np.zeros(0), len(asked_s)
    late_s = seen_s[None] - asked_s[:, None]
    nearest_s = late_s[np.arange(len(asked_s)), np.abs(late_s).argmin(axis=1)]
    matched = np.abs(nearest_s) <= MATCHED_S
    return nearest_s[matched], int(np.sum(~matched))
