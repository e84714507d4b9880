"""Pictures of the methods that hear a whole line."""

import numpy as np
import pytest
from lipservo_lab.bench.offline_models import visemes_of
from lipservo_lab.bench.pictures.line_plots import LINE_PICTURES, draw_lines, laid_out
from lipservo_lab.corpus.grid import read_grid
from lipservo_lab.evaluation.motion.methods import REFERENCE, all_methods
from lipservo_lab.evaluation.motion.motion_scores import Scores, add_scores
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


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    return read_grid(write_corpus(tmp_path_factory.mktemp("lines") / "corpus", 8))


@pytest.fixture(scope="module")
def model(corpus):
    return train(corpus, n_components=3)


@pytest.fixture(scope="module")
def models(corpus):
    recipe = Recipe(n_components=3, n_states=10)
    return OfflineModels(lambda face: train_offline(corpus, face, recipe))


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
