"""Pronunciations of the words of a text: dictionary first, then a model of spelling.

For English gruut is used: it writes numbers, money, dates and abbreviations out in words, its
lexicon (the CMU dictionary in IPA) has the pronunciations of 124,000 words, and its model guesses
the others. For other languages, and for English where gruut is not installed, the phonemes of
espeak-ng are used. Why these: docs/decisions/labels-and-text.md.

All of it is slow: call it where text arrives, never in a tick of the live loop.
"""

import re
import sqlite3
import unicodedata
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache
from importlib.util import find_spec
from itertools import groupby
from typing import Final

from lipsync.errors import MissingExtraError, UserError, check_extra
from lipsync.phonemes import SILENCE, PhonemeEvent
from lipsync.spoken_text import LONGEST_TEXT, PronouncedWord, SpokenText
from lipsync.text_to_speech.spoken_form import spoken_form

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

#: Unicode categories that no voice reads out: emoji and other symbols, control characters, half
#: surrogate pairs.
_UNSPOKEN = ("So", "Sk", "Cc", "Cf", "Cs", "Cn", "Co")
DEFAULT_LANGUAGE: Final = "en-us"
#: A capitalised word of up to so many letters before a full stop may be an abbreviation, such as
#: `Mr.` or `Capt.`, which gruut writes out.
_LONGEST_ABBREVIATION: Final = 4
_PLAIN = re.compile(r"[A-Za-z]?[a-z]*('[a-z]+)?")
_PUNCTUATION: Final = ".,;:!?\"“”‘’'()[]…-–—"
#: Phonemes without words are searched for in pieces of so many, about a word's.
_PHONES: Final = 6


class PronunciationError(UserError):
    """Error for a word or text that cannot be pronounced; the message is one line."""


def pronounced(text: str, language: str = DEFAULT_LANGUAGE) -> tuple[PronouncedWord, ...]:
    """Return the words of a text with their pronunciations; () for a text without words (emoji).

    The words are those of the text's `spoken_form`. Raises PronunciationError for a text longer
    than `LONGEST_TEXT`, for a language that cannot be pronounced, and where neither gruut nor
    espeak-ng is installed.
    """
    if len(text) > LONGEST_TEXT:
        raise PronunciationError(
            f"a text of {len(text)} characters is too long; send it in pieces of {LONGEST_TEXT}"
        )
    written = "".join(
        " " if unicodedata.category(character) in _UNSPOKEN and character != "\n" else character
        for character in spoken_form(text, language)
    )
    if not any(map(str.isalnum, written)):
        return ()
    if language.partition("-")[0] == "en" and find_spec("gruut") is not None:
        return tuple(_english_words(written))
    return tuple(_espeak_words(written, language))


def spoken_words(text: str) -> tuple[PronouncedWord, ...]:
    """Return the words of an English text with their pronunciations, at least one word.

    Raises PronunciationError as `pronounced` does, and for a text without a word.
    """
    if words := pronounced(text):
        return words
    raise PronunciationError(
        f"text {text[:40]!r} has no English word; give what is said, or no text"
    )


def pronounced_units(
    spoken: SpokenText, language: str = DEFAULT_LANGUAGE
) -> tuple[PronouncedWord, ...]:
    """Return a spoken text's words with their pronunciations, and their start times in s if known.

    Phonemes become words of up to six phones. Raises PronunciationError as `pronounced` does.
    """
    words: list[PronouncedWord] = []
    if spoken.kind == "phoneme":
        for is_silent, group in groupby(spoken.units, lambda unit: unit.label == SILENCE):
            phones = [] if is_silent else [unit.label for unit in group]
            pieces = (phones[n : n + _PHONES] for n in range(0, len(phones), _PHONES))
            words += [PronouncedWord(" ".join(piece), (tuple(piece),)) for piece in pieces]
        return tuple(words)
    for is_timed, group in groupby(spoken.units, lambda unit: unit.start_sample is not None):
        if not is_timed:
            words += pronounced(" ".join(unit.label for unit in group), language)
            continue
        for unit in group:
            start_s = (unit.start_sample or 0) / spoken.sample_rate_hz
            unit_words = pronounced(unit.label, language)
            words += [replace(word, start_s=start_s) for word in unit_words[:1]]
            words += unit_words[1:]
    return tuple(words)


def _english_words(text: str) -> Iterator[PronouncedWord]:
    """Yield an English text's words from the lexicon if it has all of them, else by gruut, slowly.

    Raises PronunciationError for a text that gruut cannot read.
    """
    plain = _plain_words(text)
    if plain is not None:
        yield from plain
        return
    from lipsync.text_to_speech.gruut_process import written_out
    from lipsync.text_to_speech.synthesis import SynthesisError

    try:
        words = written_out(text, DEFAULT_LANGUAGE)
    except SynthesisError as error:
        raise PronunciationError(str(error)) from None
    for word, ipa in words:
        candidates = dict.fromkeys([*_look_up(word.lower()), _arpabet_phones(ipa)])
        if known := tuple(phones for phones in candidates if phones):
            yield PronouncedWord(word, known)


def _plain_words(text: str) -> list[PronouncedWord] | None:
    """Return a text's words with their pronunciations in the lexicon.

    None if it lacks one of them, or one may be a number or an abbreviation.
    """
    words = []
    for written in text.split():
        word = written.strip(_PUNCTUATION)
        if not word and not any(map(str.isalnum, written)):
            continue
        is_short = written[-1] == "." and len(word) <= _LONGEST_ABBREVIATION and word[:1].isupper()
        if is_short or not _PLAIN.fullmatch(word):
            return None
        known = tuple(dict.fromkeys(phones for phones in _look_up(word.lower()) if phones))
        if not known:
            return None
        words.append(PronouncedWord(word, known))
    return words


@cache
def _lexicon() -> sqlite3.Connection:
    from gruut_lang_en import get_lang_dir

    path = get_lang_dir() / "lexicon.db"
    return sqlite3.connect(f"{path.as_uri()}?immutable=1", uri=True, check_same_thread=False)


def _look_up(word: str) -> list[tuple[str, ...]]:
    """Return the pronunciations of a lower-case word in the lexicon, the commonest first, or []."""
    rows = _lexicon().execute(
        "SELECT phonemes FROM word_phonemes WHERE word = ? ORDER BY pron_order", (word,)
    )
    return [_arpabet_phones(phonemes.split()) for (phonemes,) in rows]


def _arpabet_phones(ipa: Sequence[str]) -> tuple[str, ...]:
    """Return gruut's IPA phonemes as ARPAbet, without stress; unknown ones are left out."""
    found = (_ARPABET_OF.get(each.translate(_STRESS)) for each in ipa)
    return tuple(phone for phone in found if phone is not None)


def _espeak_words(text: str, language: str) -> Iterator[PronouncedWord]:
    """Yield a text's words with espeak-ng's phonemes. Raises PronunciationError if it fails."""
    from lipsync.text_to_speech.synthesis import SynthesisError, Voice
    from lipsync.text_to_speech.synthesizers import speak_in_pieces, synthesizer_for

    try:
        for spoken in speak_in_pieces(synthesizer_for("espeak"), text, Voice(language)):
            for word in spoken.words:
                phones = tuple(_between(spoken.phonemes, word.start_s, word.end_s))
                if phones:
                    yield PronouncedWord(word.text, (phones,))
    except SynthesisError as error:
        raise PronunciationError(
            "the pronunciation of a text needs gruut (`pip install 'lipservo[align]'`, English) "
            f"or espeak-ng: {error}"
        ) from None


def _between(events: tuple[PhonemeEvent, ...], start_s: float, end_s: float) -> Iterator[str]:
    """Yield the phonemes, without silence, that start in [start_s, end_s)."""
    for event in events:
        if event.phoneme != SILENCE and start_s - 1e-6 <= event.start_s < end_s - 1e-6:
            yield event.phoneme


@cache
def pronounce(word: str) -> tuple[str, ...]:
    """Return the phones of a lower-case English word, ARPAbet without stress, for forced alignment.

    Raises PronunciationError for a word without letters, one that gruut cannot say, and where
    gruut is not installed.
    """
    if not any(letter.isalpha() for letter in word):
        raise PronunciationError(f"word {word!r} has no letters; write it out in letters")
    phones = _arpabet_phones(_ipa(word))
    if not phones:
        raise PronunciationError(f"word {word!r} has no pronunciation; spell it as it sounds")
    return phones


def _ipa(word: str) -> list[str]:
    """Return gruut's IPA phonemes of a word. Raises PronunciationError where gruut is missing."""
    try:
        check_extra("gruut", f"word {word!r} is not in the dictionary; guessing how it sounds")
    except MissingExtraError as error:
        raise PronunciationError(str(error)) from None
    from gruut import sentences

    # Numbers, dates and money would be spelt out as other words; a word is taken as it stands.
    return [
        phone
        for sentence in sentences(word, lang=DEFAULT_LANGUAGE, verbalize_numbers=False)
        for part in sentence
        for phone in part.phonemes or ()
    ]
