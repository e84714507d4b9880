"""Self-correction: how soon the mouth is right again after one wrong phoneme.

Three cases: the error is never corrected; the recogniser corrects it a little later, and the mouth
did not wait for that; and, as a measure for both, what a phoneme that truly is another one leaves
behind, recorded and synthesised (`minimal_pairs`).
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lipservo_lab.corpus.utterance import Utterance
from lipservo_lab.evaluation.motion.methods import Heard, Method
from lipservo_lab.evaluation.motion.minimal_pairs import (
    AFTER,
    Persistence,
    find_pairs,
    made_persistence,
    persistence_of,
    recorded_persistence,
)
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipsync.arrays import Array
from lipsync.audio_block import BLOCK_S
from lipsync.phonemes import PHONEMES, SILENCE, PhonemeEvent, PhonemeUpdate
from lipsync.recognition.network import LATENCY_S

_SPOKEN = tuple(p for p in PHONEMES if p != SILENCE)


Row = dict[str, object]

NEVER_S = math.inf
#: Number of sentences that get a wrong phoneme.
_MOST_SENTENCES = 40
#: Frames a second; enough for a phone of 30 ms.
_RATE_HZ = 100.0
_N_RESAMPLINGS = 1000
#: Names of the three cases in rows.
_NEVER, _CORRECTED, _TRUE = "never corrected", "corrected after 95 ms", "another true phoneme"


def recovery_rows(
    model: TrainedModel,
    utterances: Sequence[Utterance],
    recorded: Sequence[Utterance],
    methods: Sequence[Method],
    lookaheads_ms: Sequence[int],
) -> list[Row]:
    """Return what share of a wrong phoneme's deviation remains in it and in each phoneme after.

    utterances: sentences that the model has not learned; recorded: all sentences in its head pose,
    for the share in recordings. In rows, `left` is 1 for a wrong phoneme that is never corrected;
    `left_95` is its 95 % bootstrap interval over sentences.
    """
    few, pairs = utterances[:_MOST_SENTENCES], find_pairs(utterances)
    in_recordings = recorded_persistence(model, recorded, find_pairs(recorded))
    rows = [_row(_TRUE, "recorded", None, in_recordings)]
    for method in methods:
        # A method that does not look ahead gets the whole sentence at once, right or wrong.
        delays_s = (NEVER_S, LATENCY_S) if method.looks_ahead else (NEVER_S,)
        for ms in lookaheads_ms if method.looks_ahead else lookaheads_ms[:1]:
            made = made_persistence(model, utterances, pairs, method, lookahead_s=ms / 1e3)
            rows.append(_row(_TRUE, method.name, ms, made))
            found = wrong_phoneme_persistence(model, few, method, delays_s, lookahead_s=ms / 1e3)
            cases = zip((_NEVER, _CORRECTED), found, strict=False)
            rows += [_row(case, method.name, ms, persistence) for case, persistence in cases]
    return rows


def wrong_phoneme_persistence(
    model: TrainedModel,
    utterances: Sequence[Utterance],
    method: Method,
    corrected_after_s: Sequence[float] = (NEVER_S,),
    *,
    lookahead_s: float,
    seed: int = 0,
) -> list[Persistence | None]:
    """Return how far, and for how long, one wrong phoneme in each sentence moves the mouth.

    Shares are rms distances between the motion with and without the wrong phoneme, in it and in the
    phonemes after it, over that in the wrong phoneme when it is never corrected. corrected_after_s:
    delays from the wrong phoneme's beginning to its correction; there is one result for each (None:
    nothing moved), and none if no sentence is long enough. The motion does not wait for
    corrections: the face at t is decided when the sound up to t + look-ahead was recognised.
    """
    rng = np.random.default_rng(seed)
    squares, uncorrected = [], []
    for utterance in utterances:
        phones = utterance.phones
        spoken = [i for i, p in enumerate(phones) if p.phoneme != SILENCE]
        if len(spoken) < 2 + AFTER:
            continue
        index = spoken[int(rng.integers(1, len(spoken) - AFTER))]
        wrong_phoneme = str(rng.choice([p for p in _SPOKEN if p != phones[index].phoneme]))
        compared = phones[index : index + 1 + AFTER]
        times_s = np.arange(0.0, compared[-1].end_s or 0.0, 1.0 / _RATE_HZ)
        faces = {
            delay_s: method.faces(
                model, _misheard_at(phones, index, wrong_phoneme, delay_s), times_s, lookahead_s
            )
            for delay_s in {0.0, NEVER_S, *corrected_after_s}
        }
        right = faces[0.0]
        squares.append([_squares(compared, times_s, faces[d] - right) for d in corrected_after_s])
        uncorrected.append(_squares(compared, times_s, faces[NEVER_S] - right)[0])
    if not squares:
        return []
    # unit: squares in the wrong phoneme, uncorrected. Bootstrap samples hold sentence i draws[..,
    # i] times.
    n, unit = len(squares), np.array(uncorrected)
    draws = rng.multinomial(n, np.full(n, 1.0 / n), size=_N_RESAMPLINGS)
    unit_totals = draws @ unit
    found = []
    for each in np.array(squares).transpose(1, 0, 2, 3):
        totals = np.tensordot(draws, each, axes=1)
        samples = [_shares(*both) for both in zip(totals, unit_totals, strict=True)]
        found.append(persistence_of(_shares(each.sum(axis=0), unit.sum(axis=0)), samples, n))
    return found


def _misheard_at(phones: Sequence[PhonemeEvent], index: int, wrong: str, until_s: float) -> Heard:
    """Return a recogniser's updates with one phone as `wrong` for `until_s` from its start.

    index: of that phone. Phones are known when they begin and end; only those older than
    `until_s` are final.
    """
    wrongly_heard = [*phones[:index], replace(phones[index], phoneme=wrong), *phones[index + 1 :]]
    corrected_s = phones[index].start_s + until_s
    updates = []
    for step in range(math.ceil((phones[-1].end_s or 0.0) / BLOCK_S) + 1):
        heard_s = step * BLOCK_S
        recognized = phones if heard_s >= corrected_s else wrongly_heard
        known = [p for p in recognized if p.start_s <= heard_s]
        events = tuple(p if (p.end_s or 0.0) <= heard_s else replace(p, end_s=None) for p in known)
        updates.append(PhonemeUpdate(0.0, heard_s, max(0.0, heard_s - until_s), events))
    return Heard(tuple(wrongly_heard if until_s == NEVER_S else phones), tuple(updates))


def _squares(phones: Sequence[PhonemeEvent], times_s: Array, distance: Array) -> Array:
    """Return the sum of squared distances in each phone, and the number of instants, (n_phones, 2).

    distance: (n, n_components) at times_s (n,).
    """
    found = []
    for phone in phones:
        inside = (times_s >= phone.start_s) & (times_s < (phone.end_s or 0.0))
        found.append((float((distance[inside] ** 2).sum()), float(inside.sum())))
    return np.array(found)


def _shares(squares: Array, unit: Array) -> Array:
    """Return each phone's rms over that of `unit`, (n_phones,); NaN if `unit` is 0.

    squares: (n_phones, 2), unit: (2,): sums of squares and numbers of instants.
    """
    rms = np.sqrt(squares[:, 0] / np.maximum(squares[:, 1], 1.0))
    return np.asarray(rms / np.sqrt(unit[0] / unit[1]) if unit[0] else np.full(len(rms), np.nan))


def _row(case: str, strategy: str, lookahead_ms: int | None, found: Persistence | None) -> Row:
    """Return a row of the table; `left`: shares of a difference that remain, phoneme by phoneme.

    found: None where nothing could be counted.
    """
    return {
        "case": case,
        "strategy": strategy,
        "lookahead_ms": lookahead_ms,
        "left": found and found.shares.tolist(),
        "left_95": found and found.intervals.tolist(),
        "counted": found.counted if found else 0,
    }
