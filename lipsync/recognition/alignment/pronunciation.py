"""How words sound that the aligner's dictionary does not hold: gruut's lexicon, else its model.

gruut guesses in IPA, offline; docs/decisions/0003-pronunciations.md says why it was taken.
"""

from functools import cache

from lipsync.errors import UserError
from lipsync.extras import MissingExtraError, check_extra

#: IPA of gruut's US English against ARPAbet; stress marks are stripped before.
_ARPABET_OF = {
    "æ": "AE", "ɑ": "AA", "ɔ": "AO", "ə": "AH", "ʌ": "AH", "ɐ": "AH", "ɚ": "ER", "ɝ": "ER",
    "ɛ": "EH", "ɪ": "IH", "i": "IY", "u": "UW", "ʊ": "UH", "oʊ": "OW", "eɪ": "EY", "aɪ": "AY",
    "aʊ": "AW", "ɔɪ": "OY", "b": "B", "d": "D", "f": "F", "h": "HH", "j": "Y", "k": "K",
    "l": "L", "m": "M", "n": "N", "p": "P", "ɹ": "R", "s": "S", "t": "T", "v": "V", "w": "W",
    "z": "Z", "ɡ": "G", "ŋ": "NG", "ʃ": "SH", "ʒ": "ZH", "t͡ʃ": "CH", "d͡ʒ": "JH", "θ": "TH",
    "ð": "DH",
}  # fmt: skip
_STRESS = str.maketrans("", "", "ˈˌ")


class PronunciationError(UserError):
    """A word cannot be pronounced; the message is one line."""


@cache
def pronounce(word: str) -> tuple[str, ...]:
    """The phones of one lower-case English word, ARPAbet without stress.

    Raises PronunciationError for a word without letters, one that gruut cannot say, and where
    gruut is not installed.
    """
    if not any(letter.isalpha() for letter in word):
        raise PronunciationError(f"word {word!r} has no pronunciation; write it out in letters")
    phones = tuple(
        arpabet
        for ipa in _ipa(word)
        if (arpabet := _ARPABET_OF.get(ipa.translate(_STRESS))) is not None
    )
    if not phones:
        raise PronunciationError(f"word {word!r} has no pronunciation; spell it as it sounds")
    return phones


def _ipa(word: str) -> list[str]:
    try:
        check_extra("gruut", f"word {word!r} is not in the dictionary; guessing how it sounds")
    except MissingExtraError as error:
        raise PronunciationError(str(error)) from None
    from gruut import sentences

    # Numbers, dates and money would be spelt out as other words; a word is taken as it stands.
    return [
        phone
        for sentence in sentences(word, lang="en-us", verbalize_numbers=False)
        for part in sentence
        for phone in part.phonemes or ()
    ]
