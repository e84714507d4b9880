"""Self-correction: how much wrong phonemes cost, and how soon the mouth is right again."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lipsync.animpho.model import FaceModel
from lipsync.corpus.utterance import Utterance
from lipsync.evaluation.methods import Heard, Method
from lipsync.evaluation.mishearing import KINDS, misheard
from lipsync.evaluation.speech import speech_frames
from lipsync.phonemes import SILENCE

Array = NDArray[np.float64]

ERROR_RATES = (0.0, 0.1, 0.2, 0.3, 0.5)
#: Phonemes after the wrong one that are looked at.
AFTER = 4
#: Fine enough to see a phone of 30 ms.
_RATE_HZ = 100.0


@dataclass(frozen=True, slots=True)
class ErrorRow:
    """RMSE per point over speech frames with a share `rate` of the phonemes wrong."""

    strategy: str
    kind: str
    rate: float
    rmse_mm: float


def error_rows(
    model: FaceModel,
    utterances: Sequence[Utterance],
    methods: Sequence[Method],
    *,
    lookahead_s: float,
    seed: int = 0,
) -> list[ErrorRow]:
    """Every method with every kind and rate of error; all hear the same wrong phonemes."""
    rows = []
    for kind in KINDS:
        for rate in ERROR_RATES:
            rng = np.random.default_rng([seed, KINDS.index(kind), round(rate * 100)])
            heard = [misheard(u.phones, kind, rate, rng) for u in utterances]
            for method in methods:
                squares, n_frames = 0.0, 0
                for utterance, events in zip(utterances, heard, strict=True):
                    scored = speech_frames(utterance)
                    times_s = np.arange(len(scored)) / utterance.frame_rate_hz
                    faces = method.faces(model, Heard(events), times_s, lookahead_s)
                    error = (model.markers_mm(faces) - utterance.markers_mm)[scored] ** 2
                    squares += float(error.sum()) / error.shape[1]
                    n_frames += int(scored.sum())
                rows.append(ErrorRow(method.name, kind, rate, float((squares / n_frames) ** 0.5)))
    return rows


def recovery_shares(
    model: FaceModel,
    utterances: Sequence[Utterance],
    method: Method,
    *,
    lookahead_s: float,
    seed: int = 0,
) -> Array:
    """What is left of one wrong phoneme: (1 + AFTER,), in it and in each phoneme after it.

    RMS distance between the motion with one phoneme substituted and the motion without, over that
    during the wrong phoneme itself; so the first is 1.
    """
    rng = np.random.default_rng(seed)
    squares = np.zeros(1 + AFTER)
    n_frames = np.zeros(1 + AFTER)
    for utterance in utterances:
        spoken = [i for i, p in enumerate(utterance.phones) if p.phoneme != SILENCE]
        if len(spoken) < 2 + AFTER:
            continue
        hit = spoken[int(rng.integers(1, len(spoken) - AFTER))]
        phones = utterance.phones
        wrong = misheard(phones[hit : hit + 1], "substitution", 1.0, rng)[0].phoneme
        changed = (*phones[:hit], replace(phones[hit], phoneme=wrong), *phones[hit + 1 :])
        times_s = np.arange(0.0, phones[hit + AFTER].end_s or 0.0, 1.0 / _RATE_HZ)
        distance2 = sum(
            sign * method.faces(model, Heard(events), times_s, lookahead_s)
            for sign, events in ((1.0, phones), (-1.0, changed))
        )
        for k in range(1 + AFTER):
            phone = phones[hit + k]
            inside = (times_s >= phone.start_s) & (times_s < (phone.end_s or 0.0))
            squares[k] += float((np.asarray(distance2)[inside] ** 2).sum())
            n_frames[k] += int(inside.sum())
    left = np.sqrt(squares / np.maximum(n_frames, 1.0))
    return np.asarray(left / left[0] if left[0] else left)
