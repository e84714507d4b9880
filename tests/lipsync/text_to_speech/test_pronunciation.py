"""How words may sound, and what is made of texts that are none."""

import subprocess
import sys

import pytest

from lipsync.phonemes import SILENCE, VISEME_OF
from lipsync.spoken_text import LONGEST_TEXT
from lipsync.text_to_speech.pronunciation import PronunciationError, pronounced, spoken_words


def labels(text):
    return [word.label.lower() for word in pronounced(text)]


def test_numbers_money_and_abbreviations_are_written_out():
    written = "doctor smith paid three dollars fifty cents"
    assert " ".join(labels("Dr. Smith paid $3.50")) == written


def test_a_word_has_each_pronunciation_of_the_dictionary():
    (either,) = pronounced("either")
    assert {("IY", "DH", "ER"), ("AY", "DH", "ER")} <= set(either.pronunciations)


def test_a_word_outside_the_dictionary_is_guessed():
    (word,) = pronounced("lipservo")
    assert word.pronunciations[0][:3] == ("L", "IH", "P")


@pytest.mark.parametrize("text", ["", "  ", "😀🎉", "--- ...", "\x00\ud800"])
def test_a_text_without_words_has_none(text):
    assert pronounced(text) == ()


@pytest.mark.parametrize("text", ["😀", "Привет мир", "<speak/>"])
def test_a_text_that_is_said_has_a_word(text):
    with pytest.raises(PronunciationError, match="has no English word"):
        spoken_words(text)


def test_a_text_of_a_megabyte_is_refused_in_one_line():
    with pytest.raises(PronunciationError, match=f"too long; send it in pieces of {LONGEST_TEXT}"):
        pronounced("word " * 200_000)


def test_another_language_is_pronounced_by_espeak():
    words = pronounced("Guten Tag, meine Mutter.", "de")
    assert [word.label for word in words] == ["Guten", "Tag", "meine", "Mutter"]
    phones = {phone for word in words for phone in word.pronunciations[0]}
    assert phones <= set(VISEME_OF) - {SILENCE}
    assert words[2].pronunciations[0][0] == "M"


def test_gruut_is_loaded_by_no_process_that_moves_a_mouth():
    code = (
        "import sys; from lipsync.text_to_speech.pronunciation import pronounced\n"
        "assert [word.label for word in pronounced('Dr. Who, 42')][-2:] == ['forty', 'two']\n"
        "assert 'gruut' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
