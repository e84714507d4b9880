"""What is held out for reading."""

import json

import pytest
from lipservo_lab.corpus.grid import read_grid
from lipservo_lab.corpus.utterance import CorpusError
from lipservo_lab.evaluation.readability.reading_scores import reading_parts
from small_corpus import write_corpus


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_corpus(tmp_path_factory.mktemp("corpus") / "c", 4)


def write(folder, **splits):
    (folder / "splits.json").write_text(json.dumps(splits))


def test_known_words_are_those_of_the_random_test(folder):
    write(folder, random_test=["s1", "not_here"], new_words={})
    (part,) = reading_parts(folder, read_grid(folder))
    assert (part.split, part.test, part.words) == ("known", frozenset({"s1"}), None)
    assert part.train == frozenset({"s0", "s2", "s3"})


@pytest.mark.parametrize(
    ("splits", "message"),
    [
        ({"random_test": ["x"], "new_words": {}}, "names no sentence of the folder"),
        ({"random_test": ["s0", "s1", "s2", "s3"], "new_words": {}}, "known leaves no sentence"),
        ({"random_test": ["s0"], "new_words": {"A": ["word"]}}, "new_A leaves no sentence"),
        ({"random_test": ["s0"], "new_words": {"A": ["zebra"]}}, "no sentence holds 'zebra'"),
        ({"folds": []}, "not a usable list of splits"),
    ],
)
def test_splits_that_cannot_be_held_out_say_so(folder, splits, message):
    write(folder, **splits)
    with pytest.raises(CorpusError, match=message):
        reading_parts(folder, read_grid(folder))


def test_without_splits_words_may_be_named(folder):
    (folder / "splits.json").unlink(missing_ok=True)
    with pytest.raises(CorpusError, match="--words names words instead"):
        reading_parts(folder, read_grid(folder))
