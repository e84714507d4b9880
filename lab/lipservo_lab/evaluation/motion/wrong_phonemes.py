"""What wrong phonemes cost: RMSE against the share of phonemes that are wrong."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lipservo_lab.corpus.speech_frames import speech_frames
from lipservo_lab.corpus.utterance import Utterance
from lipservo_lab.evaluation.motion.methods import Heard, Method
from lipservo_lab.evaluation.motion.mishearing import KINDS, misheard
from lipservo_lab.learning.motion.trained_model import TrainedModel

ERROR_RATES = (0.0, 0.1, 0.2, 0.3, 0.5)


@dataclass(frozen=True, slots=True)
class ErrorRow:
    """RMSE per point over speech frames with a share `rate` of the phonemes wrong."""

    strategy: str
    kind: str
    rate: float
    rmse_mm: float


def error_rows(
    model: TrainedModel,
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
