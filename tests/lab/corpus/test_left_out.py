"""Sentences that a training leaves out, by the words they hold and by their names."""

from pathlib import Path

import numpy as np
import pytest
from lipservo_lab.corpus.utterance import Corpus, CorpusError, Utterance, Word

from lipsync.markers import MARKERS_47

SAID = {"a": "bin blue now", "b": "bin red now", "c": "set blue soon"}


@pytest.fixture
def corpus() -> Corpus:
    sentences = tuple(
        Utterance(
            name, np.zeros((1, 47, 3), np.float32), 25.0, Path(f"{name}.flac"), (),
            tuple(Word(text, n, n + 1.0) for n, text in enumerate(said.split())),
        )
        for name, said in SAID.items()
    )  # fmt: skip
    return Corpus("corpus", MARKERS_47, sentences, np.zeros((3, 3)))


@pytest.mark.parametrize(
    ("words", "names", "left"),
    [("red", "", "ac"), ("", "a", "bc"), ("soon", "a", "b"), ("", "", "abc")],
)
def test_what_holds_a_word_or_is_named_is_left_out(corpus, words, names, left):
    kept = corpus.without(frozenset(words.split()), frozenset(names.split()))
    assert "".join(u.name for u in kept.utterances) == left


def test_a_word_that_nobody_says_is_refused(corpus):
    with pytest.raises(CorpusError, match="corpus: no sentence holds green"):
        corpus.without(frozenset({"green", "red"}), frozenset())


def test_leaving_out_everything_is_refused(corpus):
    with pytest.raises(CorpusError, match="no sentence is left"):
        corpus.without(frozenset({"bin"}), frozenset({"c"}))
