"""The method as Wei and Deng print it, on a made-up corpus."""

from dataclasses import replace

import numpy as np
import pytest
from lipservo_lab.corpus.grid import read_grid
from lipservo_lab.evaluation.motion.as_printed import PrintedMethod
from lipservo_lab.evaluation.motion.methods import Heard
from lipservo_lab.learning.motion.face_training import clustered_alike, cut_segments, train
from small_corpus import write_corpus

from lipsync.phonemes import PHONEMES


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    return read_grid(write_corpus(tmp_path_factory.mktemp("corpus") / "c", 8))


@pytest.fixture(scope="module")
def model(corpus):
    return train(corpus)


def test_every_component_is_chosen_and_moved_by_itself(corpus, model):
    method = PrintedMethod.of(model, corpus)
    heard, times_s = Heard(corpus.utterances[0].phones), np.arange(30) / 25.0

    faces = method.faces(model, heard, times_s, 0.1)
    assert np.ptp(faces[:, :5], axis=0).min() > 0.0
    assert (faces[:, 5:] == model.rest[5:]).all()
    other = replace(method.units[1], samples=method.units[1].samples + 1.0)
    units = (method.units[0], other, *method.units[2:])
    changed = np.ptp(replace(method, units=units).faces(model, heard, times_s, 0.1) - faces, axis=0)
    assert np.flatnonzero(changed > 1e-9).tolist() == [1]


def test_an_animpho_has_the_commonest_label_of_its_segments(corpus, model):
    learned = corpus.utterances
    segments = cut_segments(learned, [model.coefficients(u.markers_mm) for u in learned])
    # Three of four segments are alike, two of them B: one cluster, whose label is B.
    samples = np.zeros((4, 5, 8))
    samples[3] = 9.0
    b, t = PHONEMES.index("B"), PHONEMES.index("T")
    few = replace(
        segments,
        samples=samples,
        phonemes=np.array([t, b, b, t]),
        sentence=np.zeros(4, dtype=np.int64),
        weights=np.ones(4),
    )
    units = clustered_alike(few, np.zeros(8), 0, 0)
    assert sorted(units.samples[:, 0, 0].tolist()) == [0.0, 9.0]
    labels = units.phoneme_table.transposed(len(units))
    at = int(np.argmin(units.samples[:, 0, 0]))
    assert [PHONEMES[n] for n in labels[at]] == ["B"]
