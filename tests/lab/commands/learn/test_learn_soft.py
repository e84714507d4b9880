"""`lipservo learn soft` fits a model to a recogniser's weights, or says why it cannot."""

import json

import numpy as np
import pytest
from lipservo_lab.learning.motion.trained_model import load_trained_model
from small_corpus import write_corpus
from small_network import random_weights
from typer.testing import CliRunner

from lipservo.cli import app
from lipsync.recognition.network import DEFAULT_WEIGHTS, save_weights, weights_digest


def invoke(*arguments):
    return CliRunner().invoke(app, [str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def corpus(tmp_path_factory):
    return write_corpus(tmp_path_factory.mktemp("corpus") / "c", 12)


@pytest.fixture(scope="module")
def face(corpus):
    path = corpus.parent / "face.npz"
    made = invoke("learn", "face", corpus, "-o", path, "--phonemes", "true", "-q")
    assert made.exit_code == 0, made.output
    return path


def test_a_fitted_model_names_its_weights_and_keeps_all_else(corpus, face, tmp_path):
    output = tmp_path / "fitted.npz"
    answer = invoke("learn", "soft", corpus, "-o", output, "--model", face, "--json", "-q")
    assert answer.exit_code == 0, answer.output
    figures = json.loads(answer.stdout)
    assert figures["soft_weights"] == weights_digest(DEFAULT_WEIGHTS)
    before, after = load_trained_model(face), load_trained_model(output)
    assert before.soft is None
    assert after.soft is not None
    assert after.provenance["soft_weights"] == figures["soft_weights"]
    assert after.checksum == before.checksum
    assert after.training_sentences == before.training_sentences


def test_other_weights_may_hear_the_sentences_too(corpus, face, tmp_path):
    older = tmp_path / "older.npz"
    save_weights(random_weights(), older)
    alone, both = tmp_path / "alone.npz", tmp_path / "both.npz"
    given = ("learn", "soft", corpus, "--model", face, "-q")
    assert invoke(*given, "-o", alone).exit_code == 0
    assert invoke(*given, "-o", both, "--also", older).exit_code == 0
    ours, also = (load_trained_model(path) for path in (alone, both))
    assert also.provenance["soft_weights"] == weights_digest(DEFAULT_WEIGHTS)
    assert not np.array_equal(ours.soft.output, also.soft.output)
    answer = invoke(*given, "-o", tmp_path / "x.npz", "--also", tmp_path / "none.npz")
    assert answer.exit_code != 0
    assert "none.npz" in str(answer.exception or answer.output)
    assert not (tmp_path / "x.npz").exists()


def test_sentences_that_did_not_teach_the_model_are_named(face, tmp_path):
    other = write_corpus(tmp_path / "other", 4)
    answer = invoke("learn", "soft", other, "-o", tmp_path / "x.npz", "--model", face, "-q")
    assert answer.exit_code != 0
    assert "8 of the model's 12 sentences are not in it" in str(answer.exception or answer.output)
    assert not (tmp_path / "x.npz").exists()


def test_a_table_needs_what_is_held_out_and_says_so_before_anything_is_heard(
    corpus, face, tmp_path
):
    output = tmp_path / "x.npz"
    answer = invoke("learn", "soft", corpus, "-o", output, "--model", face, "--table", "-q")
    assert answer.exit_code != 0
    assert "splits.json: no such file" in str(answer.exception or answer.output)
    assert not output.exists()
