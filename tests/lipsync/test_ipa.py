"""Phonemes of any language as phones of ours."""

import unicodedata

import yaml
from hypothesis import given
from hypothesis import strategies as st
from places import DATA, ROOT

from lipsync.ipa import InventoryPhones, ipa_table, phones_of_ipa
from lipsync.phonemes import PHONEMES, SILENCE, VISEME_OF

#: Every phoneme that a voice of espeak-ng 1.51 can give out, one a line (docs/speech.md says how).
ESPEAK_PHONEMES = (DATA / "espeak_phonemes.txt").read_text("utf-8").split()


def test_a_phoneme_becomes_what_looks_like_it():
    expected = {
        "p": "P", "t͡ʃ": "CH", "tɕʰ": "CH", "ts": "T S", "yː": "UW", "ø": "OW", "œ̃": "AO",
        "ɑ̃ː": "AA", "ɲ": "N", "x": "HH", "ʁ": "HH", "ç": "HH", "ɬ": "L", "ǃ": "T", "ħ": "HH",
        "l̩": "L", "ˈeɪ": "EY", "aɪə": "AY AH", "ɛu": "EH UW", "ɑːɹ": "AA R", "ᵐb": "M B", "ː": "",
    }  # fmt: skip
    assert {each: " ".join(phones_of_ipa(each).phones) for each in expected} == expected


def test_every_row_gives_phones_of_ours_and_a_reason_where_the_symbol_is_another():
    ours = set(PHONEMES) - {SILENCE}
    for symbol, found in ipa_table().items():
        assert found
        assert set(found) <= ours, symbol
    assert {phone for found in ipa_table().values() for phone in found} == ours
    rows = yaml.safe_load((ROOT / "lipsync" / "ipa.yaml").read_text("utf-8"))
    without = {symbol for symbol, row in rows.items() if len(row) < 2}
    # One symbol a phone of the inventory, affricates in both spellings, R's vowel in both.
    assert len(without) == len(PHONEMES) - 1 + 4


def test_every_phoneme_of_every_voice_of_espeak_is_in_the_table():
    assert len(ESPEAK_PHONEMES) > 400
    for phoneme in ESPEAK_PHONEMES:
        found = phones_of_ipa(phoneme)
        assert not found.is_guess, phoneme
        assert found.phones or all(
            unicodedata.category(sign) in ("Lm", "Mn") for sign in phoneme
        ), phoneme


def test_lips_that_touch_stay_lips_that_touch():
    closed = {VISEME_OF["P"]}
    for symbol, found in ipa_table().items():
        if "BILABIAL" in unicodedata.name(symbol[0], ""):
            assert {VISEME_OF[phone] for phone in found} <= closed | {VISEME_OF["F"]}


def test_a_letter_that_the_table_lacks_is_guessed_and_said_to_be():
    for letter, expected in {"ƀ": "B", "ᶆ": "M", "語": "AH", "Ж": "AH"}.items():
        assert phones_of_ipa(letter) == InventoryPhones((expected,), is_guess=True)


@given(phoneme=st.text(max_size=12))
def test_any_text_becomes_phones_of_ours(phoneme):
    assert set(phones_of_ipa(phoneme).phones) <= set(PHONEMES) - {SILENCE}
