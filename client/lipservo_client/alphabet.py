"""Which alphabet the phoneme labels of a file or message are written in, decided by all of them.

A label alone is ambiguous: `ow` is a phone of ARPAbet, two letters of IPA, and an English word.
"""

import re
import unicodedata
from collections.abc import Iterable
from typing import Final, Literal

#: The phones of the CMU pronouncing dictionary, without stress.
_PHONES: Final = (
    "AA AE AH AO AW AY B CH D DH EH ER EY F G HH IH IY JH K L M N NG OW OY P R S SH T TH UH UW V W "
    "Y Z ZH"
)
ARPABET_PHONES: Final = frozenset(_PHONES.split())
#: Stretches that an aligner could not spell: a word outside its dictionary, a noise of the mouth.
UNSPELT: Final = ("spn", "oov", "unk")
#: Pauses by name: of the Montreal aligner, Kaldi, HTK, WebMAUS, Praat's users, Piper.
_NAMED: Final = "sil sp pau silence nsn <eps> <sil> <p:> # h# ^ $ _"
PAUSES: Final = frozenset(("", *UNSPELT, *_NAMED.split()))
#: What IPA itself writes with two ASCII letters: the Montreal aligner's and espeak's diphthongs,
#: and affricates.
ASCII_IPA: Final = frozenset(re.findall("..", "ajawejowojaiaueiouoitsdztSdZpf"))

#: Where in a word a phone stands, as Kaldi and Gentle write it: `ah_I`.
_PLACE: Final = re.compile(r"_[BIES]$")
_STRESS: Final = re.compile(r"(?<=[A-Z])[012]$")


class VendorError(ValueError):
    """An error: a vendor's message cannot be used; the text has, in one line, place and remedy."""


def is_pause(label: str) -> bool:
    """Return whether a label names a pause, or is punctuation alone."""
    is_named = label.lower() in PAUSES
    return is_named or all(unicodedata.category(sign).startswith("P") for sign in label)


def arpabet_phone(label: str) -> str | None:
    """Return the ARPAbet phone of a label in any case, without stress; None if it is none."""
    phone = _STRESS.sub("", without_place(label).upper())
    return phone if phone in ARPABET_PHONES else None


def without_place(label: str) -> str:
    """Return a label without the mark of its place in a word: `ah` of `ah_I`."""
    return _PLACE.sub("", label)


def alphabet_of(units: Iterable[tuple[str, float, float | None]]) -> Literal["arpabet", "ipa"]:
    """Return the alphabet of a file's phonemes, units (label, start s, end s), pauses left out.

    ARPAbet if every label is one of its phones, in any case, and not all are single lower-case
    letters: those (`m`, `y`) are IPA, where all but `y` mean the same. Raises VendorError for an
    ASCII word, which would else be spelled as IPA letter by letter, and for a label without
    letters.
    """
    labelled = [
        (label, f"phoneme {n} at {start_s:.3f} s")
        for n, (label, start_s, _) in enumerate(units, start=1)
        if label.strip() and not is_pause(label)
    ]
    is_arpabet = all(arpabet_phone(label) for label, _ in labelled)
    if is_arpabet and any(len(label) > 1 or label.isupper() for label, _ in labelled):
        return "arpabet"
    for label, place in labelled:
        plain = without_place(label)
        letters = plain.rstrip("0123456789")
        is_word = len(letters) > 1 and letters.isascii() and letters not in ASCII_IPA
        if is_word or (plain.isascii() and not any(map(str.isalpha, plain))):
            raise VendorError(
                f"{place}: {label[:40]!r} is neither ARPAbet nor IPA; name its alphabet "
                "(--alphabet; `alphabet` in a message), or say that it is a word (--tier words)"
            )
    return "ipa"
