"""espeak-ng's phoneme events set right against its own sound.

Measured on version 1.51 (docs/speech.md, times): most events lie at the sound to the millisecond.
Two kinds do not.

- The event of a stop or an affricate lies at its burst. The closure before it, silent but where it
  is voiced, counts to the phoneme before: here the onset is moved back over it.
- The event of a vowel after a nasal or a voiced stop lies late, by 19 ms after an M, as its
  transition is counted to the consonant: here it is moved back to where the sound jumps.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lipsync.phonemes import SILENCE
from lipsync.text_to_speech.timed_phones import TimedPhones

_STOPS = frozenset(("P", "B", "T", "D", "K", "G", "CH", "JH"))
_RELEASED = frozenset(("M", "N", "NG", "B", "D", "G"))
_VOWELS = frozenset(
    ("AA", "AE", "AH", "AO", "AW", "AY", "EH", "ER", "EY", "IH", "IY", "OW", "OY", "UH", "UW")
)

#: Below it there is no sound: espeak-ng's pauses and closures are zero to the last bit or two.
_SILENT = 0.002
#: A burst may begin this long before its event.
_BURST_EARLY_S = 0.003
#: After a pause nobody hears where a closure begins; lips close about so long before they burst.
_CLOSURE_AFTER_PAUSE_S = 0.09
#: In how much of the consonant before, counted from its end, a vowel's onset is looked for. At 120
#: words a minute the onset was up to 63 ms before its event, in the last half of an M.
_ONSET_SHARE = 0.6
#: The onset is not looked for this near to the beginning of the consonant, or to its burst.
_CONSONANT_AT_LEAST_S = 0.015
#: The two stretches whose loudness is compared, and the least rise between them that is a release.
_COMPARED_S, _STEP_S, _LEAST_RISE_DB = 0.008, 0.001, 6.0
#: A phoneme whose event comes with the next one's sounds within the one before: its share of it.
_SHARE_OF_JOINED = 1 / 3


def refined(
    phonemes: list[TimedPhones], samples: NDArray[np.float32], sample_rate_hz: int
) -> list[TimedPhones]:
    """The same phonemes, in order and without gaps as before, with the times described above."""
    found = _with_joined_apart(phonemes)
    events_s = [each.start_s for each in found]
    loud_s = np.flatnonzero(np.abs(samples) >= _SILENT) / sample_rate_hz
    edges = np.diff(samples, prepend=samples[:1])
    for index in range(1, len(found)):
        before, after = found[index - 1], found[index]
        if after.phones[0] in _STOPS:
            earliest_s = before.start_s
            if before.phones[-1] == SILENCE:
                earliest_s = max(earliest_s, after.start_s - _CLOSURE_AFTER_PAUSE_S)
            else:
                earliest_s = min(events_s[index - 1] + _CONSONANT_AT_LEAST_S, after.start_s)
            boundary_s = max(earliest_s, _closure_start_s(after.start_s, loud_s))
        elif after.phones[0] in _VOWELS and before.phones[-1] in _RELEASED:
            consonant_s = after.start_s - events_s[index - 1]
            earliest_s = max(
                events_s[index - 1] + _CONSONANT_AT_LEAST_S,
                after.start_s - _ONSET_SHARE * consonant_s,
            )
            boundary_s = _release_s(after.start_s, earliest_s, edges, sample_rate_hz)
        else:
            continue
        before.end_s = after.start_s = boundary_s
    return [each for each in found if each.end_s > each.start_s]


def _with_joined_apart(phonemes: list[TimedPhones]) -> list[TimedPhones]:
    """Copies, of which each that sounds within the one before has its share of the time."""
    found: list[TimedPhones] = []
    for each in phonemes:
        each = replace(each)
        if each.start_s == each.end_s:
            if not found or SILENCE in (each.phones[0], found[-1].phones[0]):
                continue
            before = found[-1]
            each.start_s -= _SHARE_OF_JOINED * (before.end_s - before.start_s)
            before.end_s = each.start_s
        found.append(each)
    return found


def _closure_start_s(burst_s: float, loud_s: NDArray[np.float64]) -> float:
    """Where the silence began that ends with a burst; the burst itself where there is none."""
    n_before = int(np.searchsorted(loud_s, burst_s - _BURST_EARLY_S))
    start_s = float(loud_s[n_before - 1]) if n_before else 0.0
    return start_s if start_s < burst_s - 2 * _BURST_EARLY_S else burst_s


def _release_s(
    event_s: float, earliest_s: float, edges: NDArray[np.float32], sample_rate_hz: int
) -> float:
    """Where the sound rises most shortly before the event of a vowel; the event if it does not.

    edges: differences of successive samples, which weigh what an open mouth lets out, the higher
    formants, above the murmur of a closed one.
    """
    n_compared = round(_COMPARED_S * sample_rate_hz)
    best_s, best_rise_db = event_s, _LEAST_RISE_DB
    for time_s in np.arange(earliest_s, event_s, _STEP_S):
        place = round(float(time_s) * sample_rate_hz)
        left, right = edges[max(0, place - n_compared) : place], edges[place : place + n_compared]
        if len(left) and len(right):
            rise_db = _level_db(right) - _level_db(left)
            if rise_db > best_rise_db:
                best_s, best_rise_db = float(time_s), rise_db
    return best_s


def _level_db(values: NDArray[np.float32]) -> float:
    return float(10.0 * np.log10(np.mean(np.square(values, dtype=np.float64)) + 1e-9))
