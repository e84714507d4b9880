"""The methods of `render` among those that are compared, and their pictures."""

import numpy as np
import pytest
from lipservo_lab.bench.offline_models import models_of, visemes_of
from lipservo_lab.bench.pictures.line_plots import LINE_PICTURES, draw_lines, laid_out
from lipservo_lab.corpus.grid import read_grid
from lipservo_lab.evaluation.motion.methods import REFERENCE, Heard, all_methods
from lipservo_lab.evaluation.motion.motion_scores import Scores, add_scores, true_phonemes
from lipservo_lab.evaluation.motion.offline_methods import (
    ContextVisemeMethod,
    OfflineMethod,
    OfflineModels,
)
from lipservo_lab.learning.motion.face_training import train
from lipservo_lab.learning.offline.offline_training import train_offline
from lipservo_lab.learning.offline.state_training import Recipe
from small_corpus import write_corpus

from lipservo.terminal.pictures import is_picture
from lipsync.offline.offline_model import OfflineModelError


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    return read_grid(write_corpus(tmp_path_factory.mktemp("methods") / "corpus", 8))


@pytest.fixture(scope="module")
def model(corpus):
    return train(corpus, n_components=3)


@pytest.fixture(scope="module")
def models(corpus):
    recipe = Recipe(n_components=3, n_states=10)
    return OfflineModels(lambda face: train_offline(corpus, face, recipe))


def test_both_are_scored_and_the_model_is_made_once(corpus, model, models):
    methods = [OfflineMethod("model-based", models), OfflineMethod("heard", models)]
    scores = Scores()
    add_scores(scores, model, corpus.utterances[:2], methods, [100, 200])

    for method in methods:
        assert scores.row(method.name, 100) == scores.row(method.name, 200)
        assert scores.row(method.name, 100)["sentences"] == 2
    assert models.of(model) is models.of(model)


def test_a_line_of_which_the_end_is_not_asked_for_is_made_the_same(corpus, model, models):
    utterance = corpus.utterances[0]
    heard = true_phonemes(utterance)
    frames_s = np.arange(len(utterance.markers_mm)) / utterance.frame_rate_hz

    for method in (OfflineMethod("model-based", models), OfflineMethod("heard", models)):
        whole = method.faces(model, heard, frames_s, 0.0)
        begun = method.faces(model, heard, frames_s[:12], 0.0)
        np.testing.assert_allclose(begun, whole[:12], atol=1e-9)


def test_catmull_rom_goes_through_recorded_centres_of_the_model_s_own_sentences(corpus, model):
    utterance = corpus.utterances[0]
    method = ContextVisemeMethod(visemes_of(corpus))
    spoken = [p for p in utterance.phones if p.phoneme != "SIL"]
    centres_s = np.array([(p.start_s + p.end_s) / 2.0 for p in spoken])

    made = method.faces(model, Heard(utterance.phones), centres_s, 0.0)

    recorded = method.visemes.of(model)
    assert len(recorded.faces) == sum(len(u.phones) for u in corpus.utterances)
    distances = np.abs(recorded.faces[:, None] - made).sum(axis=2)
    assert (distances.min(axis=0) < 1e-9).all()
    assert recorded is method.visemes.of(model)


def test_the_sound_is_needed(model, models):
    with pytest.raises(ValueError, match="needs the sound"):
        OfflineMethod("heard", models).faces(model, Heard(()), np.zeros(1), 0.0)


def test_a_face_of_other_sentences_gets_no_model_of_another_face(corpus, model):
    strangers = corpus.keep({"none of them"})

    with pytest.raises(OfflineModelError):
        models_of(strangers, "a test").of(model)


@pytest.mark.slow
def test_all_pictures_are_drawn(tmp_path, corpus, model, models):
    methods = [
        all_methods()[REFERENCE],
        ContextVisemeMethod(visemes_of(corpus)),
        OfflineMethod("model-based", models),
        OfflineMethod("heard", models),
    ]
    scores = Scores()
    add_scores(scores, model, corpus.utterances[:2], methods, [200])
    about = {"split": "given", "lookahead_ms": 200}
    rows = [{**about, "strategy": m.name, **scores.row(m.name, 200)} for m in methods]

    training, states = corpus.utterances, models.of(model).states
    draw_lines(tmp_path, model, states, training, training[1], methods, rows)

    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(LINE_PICTURES)
    for name in LINE_PICTURES:
        assert is_picture((tmp_path / name).read_bytes())


def test_the_same_frames_lie_in_the_same_place(corpus, model, models):
    states = models.of(model).states

    places, of_state, again = laid_out(states, corpus.utterances, corpus.utterances[0])

    assert len(places) == len(of_state) == sum(len(u.markers_mm) for u in corpus.utterances)
    np.testing.assert_array_equal(of_state, states.states)
    np.testing.assert_allclose(again, places[: len(again)], atol=1e-6)
