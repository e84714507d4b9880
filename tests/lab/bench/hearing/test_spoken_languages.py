"""The languages that espeak-ng speaks in `lipservo bench voices`."""

import pytest
from lipservo_lab.bench.hearing.told_voices import language_sentences, read_languages

from lipsync.errors import UserError


def test_there_are_ten_sentences_of_each_of_six_languages():
    sentences = language_sentences()
    assert set(sentences) == {"de", "fr", "es", "zh", "ja", "pt"}
    assert all(len(set(said)) == 10 for said in sentences.values())


def test_languages_are_chosen_by_tag_and_a_strange_one_is_named():
    assert read_languages("fr, ja") == ("fr", "ja")
    assert read_languages("") == tuple(language_sentences())
    with pytest.raises(UserError, match="--languages xx: there are no sentences in it; use de, fr"):
        read_languages("fr,xx")
