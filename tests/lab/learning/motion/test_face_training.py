"""Training on a made-up corpus, and the model file."""

import io
import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import soundfile
from lipservo_lab.corpus.grid import read_grid
from lipservo_lab.corpus.utterance import Corpus
from lipservo_lab.learning.expectation.deviation import hear_sentences
from lipservo_lab.learning.motion.face_training import (
    DEFAULT_COMPONENTS,
    TrainingError,
    cut_segments,
    train,
)
from lipservo_lab.learning.motion.trained_model import load_trained_model, save_model
from small_corpus import write_corpus

from lipsync.face.model import ModelError
from lipsync.markers import MARKERS_47
from lipsync.phonemes import PHONEMES
from lipsync.recognition.network import load_shipped_weights


@pytest.fixture(scope="module")
def corpus(tmp_path_factory) -> Corpus:
    return read_grid(write_corpus(tmp_path_factory.mktemp("corpus") / "c", 12))


@pytest.mark.slow
def test_training_twice_gives_the_same_model(corpus, tmp_path):
    for name in ("a.npz", "b.npz"):
        save_model(train(corpus, seed=3), tmp_path / name)
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_a_saved_model_comes_back_as_it_was_to_float32(corpus, tmp_path):
    model = train(corpus)
    save_model(model, tmp_path / "m.npz")
    again = load_trained_model(tmp_path / "m.npz")
    assert again.checksum == model.checksum
    assert again.training_sentences == model.training_sentences
    assert again.animphos.known_phonemes == {"SIL", "B", "AA", "T", "UW"}
    np.testing.assert_allclose(again.animphos.samples, model.animphos.samples, rtol=1e-6, atol=1e-5)
    np.testing.assert_array_equal(
        again.animphos.predecessors.indices, model.animphos.predecessors.indices
    )


def test_segments_are_five_even_samples_and_neighbours_share_one(corpus):
    motion = [np.cumsum(np.ones((len(u.markers_mm), 5)), axis=0) - 1 for u in corpus.utterances]
    segments = cut_segments(corpus.utterances, motion)
    assert segments.samples.shape == (72, 5, 5)
    # The motion is the frame number, so SIL 0..0.4 s at 25 Hz is 0, 2.5, 5, 7.5, 10.
    assert segments.samples[0, :, 0].tolist() == pytest.approx([0, 2.5, 5, 7.5, 10])
    same = segments.sentence[:-1] == segments.sentence[1:]
    np.testing.assert_allclose(segments.samples[:-1][same, -1], segments.samples[1:][same, 0])


def test_an_animpho_is_of_one_phoneme_and_is_followed_by_what_followed_in_the_corpus(corpus):
    units = train(corpus).animphos

    labels = units.phoneme_table.transposed(len(units))
    assert [len(labels[n]) for n in range(len(units))] == [1] * len(units)
    phonemes = [PHONEMES[labels[n][0]] for n in range(len(units))]
    said = [[phone.phoneme for phone in u.phones] for u in corpus.utterances]
    assert set(phonemes) == {each for sentence in said for each in sentence}
    followed = {pair for sentence in said for pair in pairwise(sentence)}
    joined = {
        (phonemes[n], phonemes[each]) for n in range(len(units)) for each in units.successors[n]
    }
    assert joined == followed


def test_the_basis_is_orthonormal_and_the_rest_is_a_closed_mouth(corpus):
    model = train(corpus)
    np.testing.assert_allclose(model.basis @ model.basis.T, np.eye(DEFAULT_COMPONENTS), atol=1e-9)
    frames = np.concatenate([u.markers_mm for u in corpus.utterances])
    gaps = [model.lip_gap_mm(c) for c in model.coefficients(frames)]
    assert model.lip_gap_mm(model.rest) < np.quantile(gaps, 0.6)


def test_a_sentence_without_sound_teaches_by_its_labels_alone(tmp_path):
    folder = write_corpus(tmp_path / "c", 3)
    soundfile.write(folder / "audio" / "s1.flac", np.zeros(19_200, np.float32), 16_000)
    corpus = read_grid(folder)
    heard = hear_sentences(load_shipped_weights(), corpus.utterances)
    assert set(heard) == {"s0", "s2"}
    model = train(corpus, heard=heard)
    assert model.provenance["sentences_heard"] == 2
    assert len(model.training_sentences) == 3


def test_a_corpus_without_labels_or_motion_is_refused(corpus):
    nothing = Corpus("c", corpus.layout, (), corpus.head_reference_mm)
    with pytest.raises(TrainingError, match="no sentence has a tier `phones`"):
        train(nothing)
    first = corpus.utterances[0]
    frozen = type(first)(
        first.name, np.zeros_like(first.markers_mm), 25.0, first.sound_path, first.phones, ()
    )
    still = Corpus("c", corpus.layout, (frozen,), corpus.head_reference_mm)
    with pytest.raises(TrainingError, match="never moves"):
        train(still)


def test_a_frame_that_is_not_a_number_is_named(corpus):
    first = corpus.utterances[0]
    markers_mm = first.markers_mm.copy()
    markers_mm[9, 3] = np.nan
    broken = type(first)(first.name, markers_mm, 25.0, first.sound_path, first.phones, ())
    with pytest.raises(TrainingError, match="s0, frame 9: markers that are not numbers"):
        train(Corpus("c", corpus.layout, (broken,), corpus.head_reference_mm))


def test_one_sentence_is_enough(corpus):
    assert len(train(corpus.keep({"s0"})).animphos) >= 1


@pytest.fixture
def saved(corpus, tmp_path) -> Path:
    path = tmp_path / "m.npz"
    save_model(train(corpus), path)
    return path


def changed(path: Path, **arrays: np.ndarray) -> bytes:
    """The model file with some of its arrays replaced."""
    with np.load(path) as file:
        content = {key: file[key] for key in file.files} | arrays
    buffer = io.BytesIO()
    np.savez(buffer, **content)
    return buffer.getvalue()


def about(path: Path, **fields: object) -> np.ndarray:
    with np.load(path) as file:
        content = json.loads(file["about"].tobytes()) | fields
    return np.frombuffer(json.dumps(content).encode(), dtype=np.uint8)


def beyond_all(path: Path) -> np.ndarray:
    with np.load(path) as file:
        return np.concatenate([[10_000], file["animphos/successors"][1:]])


def test_a_missing_model_file_says_how_to_get_one(tmp_path):
    with pytest.raises(ModelError, match="no such model file; train one with"):
        load_trained_model(tmp_path / "none.npz")


@pytest.mark.parametrize(
    ("damaged", "told"),
    [
        (lambda _: b"", "damaged or not a lipservo model"),
        (lambda _: b"PK\x03\x04 broken", "damaged or not a lipservo model"),
        (lambda path: path.read_bytes()[:-500], "damaged"),
        (lambda path: changed(path, about=about(path, version=99)), "version 99.*train it again"),
        (lambda path: changed(path, about=about(path, phonemes=["A"])), "phonemes are not those"),
        (lambda path: changed(path, **{"face/rest": np.zeros(4, np.float32)}), "rest has shape"),
        (
            lambda path: changed(path, **{"face/rest": np.full(DEFAULT_COMPONENTS, np.nan)}),
            "rest has values that are not finite",
        ),
        (
            lambda path: changed(path, **{"animphos/successors": beyond_all(path)}),
            "names a piece of motion beyond the",
        ),
    ],
)
def test_a_damaged_file_is_refused_with_what_is_wrong(saved, damaged, told):
    saved.write_bytes(damaged(saved))
    with pytest.raises(ModelError, match=told):
        load_trained_model(saved)


def test_the_shipped_model_is_whole():
    model = load_trained_model()
    assert model.layout == MARKERS_47
    assert 2.5 < model.animphos.mean_successors < 3.6
    assert model.lip_gap_mm(model.rest) < 1.0
