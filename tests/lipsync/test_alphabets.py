"""Phonemes and visemes of others, against what their vendors document."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lipsync.alphabets import AlphabetError, alphabets, in_inventory, phones_of, viseme_sets
from lipsync.errors import UserError
from lipsync.ipa import phones_of_ipa
from lipsync.phonemes import PHONEMES, VISEME_OF
from lipsync.spoken_text import SpokenUnit

#: Which phonemes of English each viseme stands for, as the pages named in alphabets.yaml say.
DOCUMENTED = {
    "azure": "1 æ ə ʌ|2 ɑ|3 ɔ|4 ɛ ʊ|5 ɝ|6 j i ɪ|7 w u|8 o|9 aʊ|10 ɔɪ|11 aɪ|12 h|13 ɹ|14 l|15 s z|"
    "16 ʃ tʃ dʒ ʒ|17 ð|18 f v|19 d t n θ|20 k ɡ ŋ|21 p b m",
    "polly": "p p b m|t t d n|S ʃ ʒ tʃ dʒ|T θ ð|f f v|k k ɡ h ŋ|i i ɪ j|r ɹ|s s z|u u ʊ w|@ ə ɚ|"
    "a æ aɪ aʊ ɑ|e eɪ|E ɛ ʌ ɝ|o oʊ|O ɔ ɔɪ|l l|J ɲ ʎ|B β",
    "ovr": "PP p b m|FF f v|TH θ ð|DD t d|kk k ɡ|CH tʃ dʒ ʃ|SS s z|nn n l|RR ɹ|aa ɑ|E e|I ɪ|ih ɪ|"
    "O o|oh o|U u|ou u",
    "inworld": "aei æ ʌ|bmp p b m|cdgknstxyz d ɡ k n s t z|chjsh ʃ tʃ dʒ|ee i|fv f v|l l|o o ɔ|"
    "qw w|r ɹ|th θ ð|u u ʊ",
}  # fmt: skip
PHONEMES_OF = {
    name: {row.split()[0]: row.split()[1:] for row in rows.split("|")}
    for name, rows in DOCUMENTED.items()
}
#: Of each set: phonemes that look otherwise than the phone of their viseme, as one viseme stands
#: for unlike ones. None of them closes the lips, and none is taken for one that does.
UNLIKE = {
    "azure": {"æ", "ʊ", "w", "θ"},
    "polly": {"h", "w", "ɚ", "ʌ", "ɝ", "æ"},
    "ovr": set(),
    "inworld": {"æ", "ɡ", "k"},
}
CLOSING = {VISEME_OF["P"], VISEME_OF["F"]}


@pytest.mark.parametrize("name", DOCUMENTED)
def test_a_set_has_every_documented_viseme_and_silence(name):
    extra = set(viseme_sets()[name]) - set(PHONEMES_OF[name])

    assert extra <= {"0", "sil", "stop", "[silence]"}
    assert {phones_of(each, name) for each in extra} == {("SIL",)}
    assert all(reason for _, reason in viseme_sets()[name].values())


@pytest.mark.parametrize("name", DOCUMENTED)
def test_a_viseme_looks_like_the_phonemes_that_it_stands_for(name):
    unlike = set()
    for viseme, phonemes in PHONEMES_OF[name].items():
        (phone,) = phones_of(viseme, name)
        for each in phonemes:
            looks = VISEME_OF[phones_of_ipa(each).phones[0]]
            if looks != VISEME_OF[phone]:
                assert not CLOSING & {looks, VISEME_OF[phone]}
                unlike.add(each)

    assert unlike == UNLIKE[name]


def test_x_sampa_is_ipa_in_ascii():
    sampa = pytest.importorskip("gruut_ipa.sampa", reason="gruut of the extra `align` is absent")
    #: In it a precomposed letter is missing, affricates are single, and marks are whole labels.
    others = {"C", "ts`", "dz`", "k_x"}
    for symbol, ipa in sampa.SAMPA_TO_IPA.items():
        if symbol not in others and any(letter.isalpha() and letter.islower() for letter in ipa):
            if ipa in "ʰʲˠʷˤ":
                continue
            assert phones_of(symbol, "x-sampa") == phones_of_ipa(ipa).phones, symbol
    assert phones_of("m{n_h", "x-sampa") == ("M", "AE", "N")


@pytest.mark.parametrize(
    ("label", "alphabet", "error"),
    [
        ("Q", "polly", "'Q' is not a viseme of polly, which has: sil p"),
        ("q", "", "'q' is not an ARPAbet phoneme; write SIL"),
        ("AH9", "arpabet", "'AH9' is not an ARPAbet phoneme"),
        ("m", "klingon", "alphabet 'klingon' is not known; use one of: arpabet, ipa, x-sampa, "),
        ("x" * 1000, "azure", " is not a viseme of azure"),
    ],
)
def test_an_unknown_label_or_alphabet_is_one_line_that_says_what_there_is(label, alphabet, error):
    with pytest.raises(AlphabetError) as raised:
        phones_of(label, alphabet)

    assert error in str(raised.value)
    assert len(str(raised.value)) < 300
    assert "\n" not in str(raised.value)


def test_kokoro_writes_diphthongs_as_capitals():
    assert phones_of("hˈI", "misaki") == ("HH", "AY")
    assert phones_of("bˈOt", "misaki") == ("B", "OW", "T")


def test_a_phoneme_of_several_phones_shares_its_time_and_a_mark_of_length_goes_on():
    units = [SpokenUnit("ʦ", 0, 101), SpokenUnit("ː", 101, 160), SpokenUnit("m", 160)]

    assert in_inventory("phoneme", units, "ipa", 16_000).units == (
        SpokenUnit("T", 0, 50),
        SpokenUnit("S", 50, 160),
        SpokenUnit("M", 160, None),
    )


def test_the_number_of_a_unit_that_its_alphabet_lacks_is_told():
    with pytest.raises(AlphabetError, match="viseme 2: '22' is not a viseme of azure"):
        in_inventory("viseme", [SpokenUnit("21", 0), SpokenUnit("22", 9)], "azure", 16_000)


@given(label=st.text(max_size=6), alphabet=st.sampled_from(alphabets()))
def test_any_label_is_phones_of_the_inventory_or_one_line(label, alphabet):
    try:
        phones = phones_of(label, alphabet)
    except UserError as error:
        if "\n" in str(error):
            raise
        return
    assert set(phones) <= set(PHONEMES)
