"""The phone that is going on, as a stretch of time for an AnimPho to fill."""

import math
from dataclasses import dataclass

from lipsync.motion.rest_plan import PAUSE_S
from lipsync.phonemes import PHONEMES, SILENCE, stand_in

#: A phone is taken to last so long, the median of grid_s1; where its end is later than is known,
#: a recorded frame longer than is known.
USUAL_S = 0.08
LONGER_S = 0.04
#: Of a longer phone an AnimPho fills this much, up to its end.
LONGEST_S = 0.35


@dataclass(frozen=True, slots=True)
class PhoneSpan:
    """A phone, or one of several that stand in for it one after the other.

    phoneme: one that the AnimPhos know; None for a pause, in which the mouth rests. onset_s: of the
    whole phone, in sound time; start_s, end_s: what the AnimPho fills. is_known: whether the end is
    the phone's own, and no guess.
    """

    phoneme: str | None
    onset_s: float
    start_s: float
    end_s: float
    is_known: bool


def span_at(
    context: tuple[list[int], list[float]],
    time_s: float,
    known_s: float,
    known_phonemes: frozenset[str],
) -> PhoneSpan:
    """What goes on at `time_s`; context: `context_at` it, known for `known_s` more."""
    phonemes, times_s = context
    phoneme = PHONEMES[phonemes[2]]
    onset_s, is_known = time_s - times_s[2], not math.isnan(times_s[3])
    is_pause = times_s[2] > PAUSE_S and not is_known
    if phoneme == SILENCE and (is_pause or SILENCE not in known_phonemes):
        return PhoneSpan(None, onset_s, onset_s, math.inf, is_known)
    end_s = time_s + times_s[3]
    if not is_known:
        end_s = max(onset_s + USUAL_S, time_s + known_s + LONGER_S)
    parts, number, start_s = stand_in(phoneme, known_phonemes), 0, onset_s
    if len(parts) > 1:
        part_s = (end_s - onset_s) / len(parts)
        number = min(len(parts) - 1, int((time_s - onset_s) / part_s))
        start_s += number * part_s
        end_s = start_s + part_s
    return PhoneSpan(parts[number], onset_s, max(start_s, end_s - LONGEST_S), end_s, is_known)
