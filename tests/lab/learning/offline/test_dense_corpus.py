"""A corpus of dense scans: any number of points, and a face that has some of them."""

from dataclasses import replace

import numpy as np
import pytest
from lipservo_lab.corpus.grid import read_grid
from lipservo_lab.corpus.utterance import Corpus
from lipservo_lab.learning.motion.face_training import train
from lipservo_lab.learning.offline.offline_training import train_offline
from lipservo_lab.learning.offline.state_training import BuildingError, Recipe, build_states
from small_corpus import write_corpus

from lipsync.audio.file import read_speech
from lipsync.markers import MARKERS_47, PointLayout
from lipsync.offline.line_methods import Line, Speaker, model_based_line

pytest.importorskip("dtaidistance", reason="the model-based method needs the extra `offline`")

RECIPE = Recipe(n_components=5, n_states=12)


def dense(corpus: Corpus, n_points: int) -> Corpus:
    """The same motion with further points that move as mixtures of the first ones."""
    n = corpus.layout.n_points
    mixture = np.random.default_rng(0).dirichlet(np.ones(n), n_points - n).astype(np.float32)
    groups = (*corpus.layout.groups, ("skin", tuple(range(10_000, 10_000 + n_points - n))))
    layout = PointLayout(f"dense-{n_points}", groups, corpus.layout.gap_landmarks)
    utterances = tuple(
        replace(
            u,
            markers_mm=np.concatenate(
                [u.markers_mm, np.einsum("qp,fpc->fqc", mixture, u.markers_mm)], axis=1
            ),
        )
        for u in corpus.utterances
    )
    return replace(corpus, layout=layout, utterances=utterances)


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    return read_grid(write_corpus(tmp_path_factory.mktemp("corpus") / "c", 4))


@pytest.fixture(scope="module")
def face(corpus):
    return train(corpus, n_components=4)


def test_states_of_2000_points_give_lines_on_a_face_of_47(corpus, face):
    many = dense(corpus, 2000)

    offline = train_offline(many, face, RECIPE)

    assert offline.provenance["points"] == 2000
    assert offline.face_checksum == face.checksum
    said = corpus.utterances[0]
    line = Line(said.phones, read_speech(said.sound_path))
    planned = model_based_line(Speaker(face, None, offline), line, len(said.markers_mm))
    assert planned.faces.shape == (len(said.markers_mm), face.n_components)
    shown_mm = face.markers_mm(planned.faces)
    assert np.abs(shown_mm - said.markers_mm).mean() < np.abs(said.markers_mm).std() / 10.0


def test_what_dense_states_say_is_told_at_the_points_of_the_face(corpus, face):
    many = dense(corpus, 300)
    at_frames = [np.zeros((len(u.markers_mm), 2)) for u in many.utterances]
    whole = build_states(many.utterances, at_frames, RECIPE)

    kept = train_offline(many, face, RECIPE).states

    motion = np.random.default_rng(1).normal(size=(6, whole.n_components))
    points_mm = (whole.mean_mm + motion @ whole.basis).reshape(6, 300, 3)[:, :47]
    told_mm = (kept.mean_mm + motion @ kept.basis).reshape(6, 47, 3)
    assert told_mm == pytest.approx(points_mm, abs=1e-9)
    assert many.layout.names[:47] == MARKERS_47.names


def test_a_face_of_dense_points_is_trained_and_wears_its_own_states(corpus):
    many = dense(corpus, 700)  # 2,100 coordinates: no covariance is formed
    face = train(many, n_components=4)

    offline = train_offline(many, face, RECIPE)

    assert face.basis @ face.basis.T == pytest.approx(np.eye(4), abs=1e-6)
    assert offline.states.basis.shape == (5, 2100)


def test_a_corpus_without_a_point_of_the_face_and_too_many_components_are_refused(corpus, face):
    few = PointLayout("few", (("inner_lip", (13, 14)),), (13, 14))
    lips = tuple(replace(u, markers_mm=u.markers_mm[:, :2]) for u in corpus.utterances)

    with pytest.raises(BuildingError, match="lacks 45 of the 47"):
        train_offline(replace(corpus, layout=few, utterances=lips), face, RECIPE)
    with pytest.raises(BuildingError, match=r"119 at most \(--components\)"):
        train_offline(corpus, face, Recipe(n_components=500, n_states=12))
