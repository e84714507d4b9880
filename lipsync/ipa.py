"""Conversion of IPA phonemes of any language to phones of the inventory, by their lip shapes.

The table with its reasons is ipa.yaml beside this file.
"""

import unicodedata
from dataclasses import dataclass
from functools import cache, lru_cache
from importlib.resources import files
from types import MappingProxyType

import yaml

_NEUTRAL_VOWEL = "AH"


@dataclass(frozen=True, slots=True)
class InventoryPhones:
    """Phones for an IPA phoneme, none for a mark alone; `is_guess`: a letter is not in ipa.yaml."""

    phones: tuple[str, ...]
    is_guess: bool


@cache
def ipa_table() -> MappingProxyType[str, tuple[str, ...]]:
    """Return the phones of the inventory for every IPA symbol of ipa.yaml, in the file's order."""
    text = files("lipsync").joinpath("ipa.yaml").read_text("utf-8")
    rows: dict[str, list[str]] = yaml.safe_load(text)
    return MappingProxyType({symbol: tuple(row[0].split()) for symbol, row in rows.items()})


@lru_cache(maxsize=1024)
def phones_of_ipa(phoneme: str) -> InventoryPhones:
    """Return the phones of the inventory for one phoneme written in IPA, with any marks.

    The longest symbols of the table are replaced first, from the left, so that a diphthong which
    the inventory lacks becomes its two ends. A letter that the table lacks is replaced by the plain
    letter in its Unicode name ("b with hook" for b), and failing that by a neutral vowel: a guess.
    """
    table = ipa_table()
    symbols = _without_marks(phoneme)
    if not symbols:
        symbols = "".join(letter for letter in phoneme if letter in table)
    longest = max(map(len, table))
    phones: list[str] = []
    is_guess = False
    index = 0
    while index < len(symbols):
        for length in range(min(longest, len(symbols) - index), 0, -1):
            found = table.get(symbols[index : index + length])
            if found is not None:
                phones += found
                break
        else:
            length, is_guess = 1, True
            phones += _phones_of_similar(symbols[index])
        index += length
    return InventoryPhones(tuple(phones), is_guess)


def _without_marks(phoneme: str) -> str:
    """Return the letters of an IPA phoneme alone: no diacritics, punctuation, digits or spaces."""
    decomposed = unicodedata.normalize("NFD", phoneme.replace("ç", "\0"))
    letters = (
        letter
        for letter in decomposed
        if letter in "\0?ᵐⁿᵑ" or unicodedata.category(letter) in ("Lu", "Ll", "Lo")
    )
    return "".join(letters).replace("\0", "ç")


def _phones_of_similar(letter: str) -> tuple[str, ...]:
    """Return the phones of the plain letter in a letter's Unicode name, else the neutral vowel."""
    words = unicodedata.name(letter, "").split(" WITH ")[0].split()
    found = ipa_table().get(words[-1].lower()) if words else None
    return found or (_NEUTRAL_VOWEL,)
