"""The baselines, checked against their formulas, another library, and motion that they made."""

import numpy as np
from lipservo_lab.baselines.baselines import (
    Dominance,
    fit_regression,
    fixed_reference,
)
from lipservo_lab.baselines.tuning import tune_dominance
from lipservo_lab.corpus.utterance import speech_frames
from recorded_phrase import PHRASE, recorded
from small_model import small_model

from lipsync.phonemes import PHONEMES


def test_the_reference_is_the_formula_of_the_definition():
    """D = exp(-(24 |tau|)^1.4) from the centre, from the edge for silence, 0 inside."""
    centres = small_model().baselines.centres
    t = 0.50
    taus = [0.10, 0.50 - 0.46, 0.62 - 0.50, 0.82 - 0.50, 0.98 - 0.50, 1.04 - 0.50]
    weights = np.exp(-((24 * np.array(taus)) ** 1.4))
    targets = centres[[PHONEMES.index(p.phoneme) for p in PHRASE]]
    expected = weights @ targets / weights.sum()
    made = fixed_reference().face_at(PHRASE, centres, np.array([t]))[0]
    np.testing.assert_allclose(made, expected)


def test_tuning_finds_the_dominance_that_made_the_motion():
    model, utterance = small_model(), recorded()
    true = Dominance(np.full((16, 2), 60.0), np.full((16, 2), 1.0))
    times_s = np.arange(36) / 25.0
    motion = true.face_at(PHRASE, model.baselines.centres, times_s)
    tuned = tune_dominance([utterance], [motion], model.baselines.centres)

    def error(dominance: Dominance) -> float:
        speech = speech_frames(utterance)
        return float(
            (
                (dominance.face_at(PHRASE, model.baselines.centres, times_s) - motion)[speech] ** 2
            ).sum()
        )

    assert error(tuned) < 0.01 * error(fixed_reference())


def test_the_plain_regression_recovers_a_linear_rule():
    rng = np.random.default_rng(0)
    phonemes = rng.integers(0, 41, (20_000, 5))
    effect = rng.normal(size=(41, 3))
    faces = effect[phonemes[:, 2]]
    unknown = np.full((20_000, 6), np.nan)
    regression = fit_regression(phonemes, unknown, np.zeros(20_000), faces)
    made = regression.faces(phonemes, unknown, np.zeros(20_000))
    assert np.abs(made - faces).max() < 0.6
    assert ((made - faces) ** 2).mean() < 0.05
