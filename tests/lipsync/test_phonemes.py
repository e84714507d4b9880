import pytest

from lipsync.phonemes import PHONEMES, SILENCE, VISEME_CLASSES, VISEME_OF, stand_in

#: What the talker of the GRID corpus never said.
MISSING = frozenset({"SH", "ZH", "NG", "ER", "OY", "UH"})
SAID = frozenset(PHONEMES) - MISSING


def test_the_inventory_is_the_39_phones_of_cmu_and_silence():
    assert len(PHONEMES) == 40
    assert sum(len(viseme) for viseme in VISEME_CLASSES) == 40
    assert set(VISEME_OF) == set(PHONEMES)


@pytest.mark.parametrize("phoneme", PHONEMES)
def test_every_phoneme_is_shown_by_phonemes_that_are_known(phoneme):
    parts = stand_in(phoneme, SAID)

    assert parts
    assert set(parts) <= SAID
    assert (parts == (phoneme,)) == (phoneme in SAID)


def test_the_stand_in_looks_like_the_missing_phoneme():
    expected = {
        "OY": ("AO", "IY"), "NG": ("N",), "ER": ("R",), "UH": ("UW",), "SH": ("CH",), "ZH": ("CH",)
    }  # fmt: skip
    assert {phoneme: stand_in(phoneme, SAID) for phoneme in MISSING} == expected


def test_a_sound_that_nothing_known_resembles_still_moves_the_mouth():
    assert stand_in("M", frozenset({SILENCE, "AH", "S"})) == ("AH",)
    assert stand_in("M", frozenset({SILENCE, "S"})) == ("S",)
    assert stand_in("M", frozenset({SILENCE})) == (SILENCE,)


def test_a_phoneme_outside_the_inventory_and_an_empty_list_are_refused():
    with pytest.raises(ValueError, match="unknown phoneme 'AX'"):
        stand_in("AX", SAID)
    with pytest.raises(ValueError, match="the list of phonemes is empty"):
        stand_in("M", frozenset())
