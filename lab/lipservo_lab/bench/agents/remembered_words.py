"""Sound whose samples tell which word they are, and what an agent remembers of it."""

import re
from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

#: The value of a word's samples is this and its number in the turn.
FIRST_VALUE: Final = 1_000
WORD_S: Final = 0.2


#: Words of a turn, at most: their values are their turn's own, so that old sound is known again.
MOST_WORDS: Final = 100


def first_of_turn(number: int) -> int:
    """Return the number of the first word of a turn, of 300 turns at most."""
    return MOST_WORDS * (number % 300)


def worded_pcm(n_words: int, rate_hz: int, first: int = 0) -> bytes:
    """Return the sound of words `first` to `first + n_words`, s16le: 0.2 s each."""
    values = FIRST_VALUE + first + np.arange(n_words)
    return bytes(np.repeat(values, round(WORD_S * rate_hz)).astype("<i2").tobytes())


def wrongly_remembered(
    words: Sequence[str], heard: Mapping[int, int], remembered: str, rate_hz: int, first: int = 0
) -> tuple[int, int]:
    """Return the numbers of words remembered and not heard, and heard and forgotten.

    heard: number of samples that left the loudspeaker, by value. The word within which the sound
    stopped may be remembered or not. first: number of the first word.
    """
    n_word = round(WORD_S * rate_hz)
    known = set(re.findall(r"\w+", remembered))
    values = range(FIRST_VALUE + first, FIRST_VALUE + first + len(words))
    shares = [heard.get(value, 0) / n_word for value in values]
    unheard = sum(word in known and share == 0.0 for word, share in zip(words, shares, strict=True))
    forgotten = sum(
        word not in known and share >= 1.0 for word, share in zip(words, shares, strict=True)
    )
    return unheard, forgotten
