"""What is held out of a folder, and what a folder must hold."""

import json
from pathlib import Path

import pytest
from lipservo_lab.corpus.grid import read_grid
from lipservo_lab.corpus.utterance import CorpusError
from lipservo_lab.evaluation.motion.motion_scores import check_scorable, read_parts, words_part
from small_corpus import write_corpus
from small_model import small_model

from lipsync.markers import MARKERS_39


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    path = write_corpus(tmp_path_factory.mktemp("corpus") / "c", 6)
    splits = {"folds": [["s0", "s1"], ["s2", "s3"]], "new_words": {"A": ["word"]}}
    (path / "splits.json").write_text(json.dumps(splits))
    return path


def test_folds_and_words_train_on_the_rest(folder):
    corpus = read_grid(folder)
    with pytest.raises(CorpusError, match="split A leaves no sentence to train on"):
        read_parts(folder, corpus)
    (folder / "splits.json").write_text(json.dumps({"folds": [["s0"], ["s1"]], "new_words": {}}))
    parts = read_parts(folder, corpus)
    assert [sorted(p.test) for p in parts] == [["s0"], ["s1"]]
    assert all(not p.test & p.train and len(p.train) == 5 for p in parts)


def test_a_word_that_nobody_says_is_named(folder):
    with pytest.raises(CorpusError, match="no sentence holds 'xylophone'"):
        words_part("words", read_grid(folder), frozenset({"xylophone"}))


@pytest.mark.parametrize(
    ("content", "message"),
    [("{", "not a usable list"), ('{"folds": [["x"]], "new_words": {}}', "names no sentence")],
)
def test_a_bad_list_of_splits_says_so(folder, content, message):
    (folder / "splits.json").write_text(content)
    with pytest.raises(CorpusError, match=message):
        read_parts(folder, read_grid(folder))


def test_a_model_of_other_markers_is_refused(folder):
    corpus = read_grid(folder)
    other = type(corpus)(corpus.name, MARKERS_39, corpus.utterances, corpus.head_reference_mm)
    with pytest.raises(CorpusError, match="markers other than the model's"):
        check_scorable(small_model(), other)
