"""Sound whose samples tell which word they are, and what an agent remembers of it."""

import re
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

#: The value of a word's samples is this plus the word's number.
FIRST_VALUE: Final = 1_000
WORD_S: Final = 0.2


#: The most words of a turn. Turns have different values, so that sound of an earlier turn is seen.
MOST_WORDS: Final = 100


def first_of_turn(number: int) -> int:
    """Return the number of a turn's first word. Numbers repeat after 300 turns."""
    return MOST_WORDS * (number % 300)


def worded_pcm(n_words: int, rate_hz: int, first: int = 0) -> bytes:
    """Return the sound of `n_words` words numbered from `first`, as s16le bytes, 0.2 s each.

    All samples of a word have one value, `FIRST_VALUE` plus its number.
    """
    values = FIRST_VALUE + first + np.arange(n_words)
    return bytes(np.repeat(values, round(WORD_S * rate_hz)).astype("<i2").tobytes())


def wrongly_remembered(
    words: Sequence[str], heard: Mapping[int, int], remembered: str, rate_hz: int, first: int = 0
) -> tuple[int, int]:
    """Return how many words are remembered but unheard, and how many heard but forgotten.

    Heard is a word that was played whole, unheard one of which no sample was played; the word in
    which the sound stopped may be remembered or not. heard: number of samples played, by value.
    remembered: the agent's text. first: number of the first word.
    """
    n_word = round(WORD_S * rate_hz)
    known = set(re.findall(r"\w+", remembered))
    values = range(FIRST_VALUE + first, FIRST_VALUE + first + len(words))
    # Of each word, the share of its samples that was played.
    shares = [heard.get(value, 0) / n_word for value in values]
    unheard = sum(word in known and share == 0.0 for word, share in zip(words, shares, strict=True))
    forgotten = sum(
        word not in known and share >= 1.0 for word, share in zip(words, shares, strict=True)
    )
    return unheard, forgotten
