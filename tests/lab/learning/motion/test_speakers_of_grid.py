"""Two halves of a recorded speaker, one of them on another face. Minutes: campaign."""

from dataclasses import replace

import numpy as np
import pytest
from lipservo_lab.corpus.grid import read_grid
from lipservo_lab.corpus.utterance import Corpus
from lipservo_lab.evaluation.motion.methods import all_methods
from lipservo_lab.evaluation.motion.motion_scores import Scores, add_scores
from lipservo_lab.learning.motion.face_training import train
from lipservo_lab.learning.motion.several_speakers import on_one_face
from scipy.spatial.transform import Rotation

N_EACH, N_HELD_OUT = 80, 60
#: What one speaker's training may be better by.
MOST_GAP_R_LOST = 0.02
MOST_MM = 0.3


@pytest.fixture(scope="module")
def sentences(corpus_dir):
    """Labelled sentences in an order by chance, and the face that they have on average."""
    corpus = read_grid(corpus_dir / "grid_s1").labelled()
    order = np.random.default_rng(4).permutation(len(corpus.utterances))
    return corpus, [corpus.utterances[i] for i in order]


def on_another_face(utterances, layout):
    """Stretched, with a longer chin and jaw, turned and moved."""
    middle = np.concatenate([u.markers_mm for u in utterances]).mean(axis=0)
    rotation = Rotation.from_euler("xyz", (8, -5, 3), degrees=True).as_matrix()
    longer = np.array([[0, -5.0, 2.0]]) * np.array(
        [[name.startswith(("jaw", "chin"))] for name in layout.names]
    )
    return tuple(
        replace(
            u,
            markers_mm=(
                ((u.markers_mm - middle) * (1.15, 0.8, 1.3) + middle + longer) @ rotation.T
            ).astype(np.float32),
        )
        for u in utterances
    )


def gap_r(model, utterances):
    scores = Scores()
    add_scores(scores, model, utterances, [all_methods()["expected"]], [100])
    return scores.row("expected", 100)["gap_r"]


@pytest.mark.campaign
def test_a_second_face_is_as_good_as_one_speaker(sentences):
    corpus, order = sentences
    first, second = order[:N_EACH], order[N_EACH : 2 * N_EACH]
    held_out = order[2 * N_EACH : 2 * N_EACH + N_HELD_OUT]
    head, layout = corpus.head_reference_mm, corpus.layout
    joined, _ = on_one_face(
        [
            Corpus("first", layout, tuple(first), head),
            Corpus("second", layout, on_another_face(second, layout), head),
        ]
    )
    brought_mm = [
        ours.markers_mm - u.markers_mm
        for ours, u in zip(joined.utterances[N_EACH:], second, strict=True)
    ]
    assert np.sqrt((np.concatenate(brought_mm) ** 2).sum(axis=2).mean()) < MOST_MM
    alone = train(Corpus("one", layout, (*first, *second), head))
    both = train(joined)
    assert gap_r(both, held_out) > gap_r(alone, held_out) - MOST_GAP_R_LOST
