"""What people heard of a stream: its words against the samples that were played."""

import re
from itertools import accumulate, pairwise
from typing import Final

#: Scripts that write no space between words: each of their characters is a word here.
_UNSPACED: Final = "\u0e00-\u0eff\u3040-\u30ff\u3400-\u9fff"
_WORD: Final = re.compile(rf"\s*(?:[{_UNSPACED}]|[^\s{_UNSPACED}]+)[.,!?\u3001\u3002]*")
#: English read aloud: 150 words a minute, six characters for a word and its space. A word without a
#: known end lasts at most twice as long as that: the rest until the next word is a pause.
_CHARACTERS_PER_S, _SLOWEST_FACTOR = 15.0, 2.0
#: A word lasts as long as its letters and these together: over 890 sentences of GRID, borders so
#: estimated lie .104 s (RMS) beside the labelled ones, with one letter .106 s, with twenty .113 s.
_MORE_LETTERS: Final = 3


class SpokenWords:
    """The words of one stream, in the order in which they are spoken, and the samples they last.

    A word counts as heard when half of its samples were played, and no word does before any sample
    was. Between known places, words share the sound by their length in letters. n_samples: of the
    stream so far.
    """

    def __init__(self, rate_hz: int, n_samples: int = 0) -> None:
        self.rate_hz = rate_hz
        self.n_samples = n_samples
        self._pieces: list[tuple[str, int | None, int | None]] = []

    def add(self, text: str, start: int | None = None, end: int | None = None) -> int:
        """Append a piece, a text or word, and return its number.

        start, end: samples of the stream. Without a start the piece follows the one before; without
        an end it lasts until the next piece that has a start, or the end of the sound.
        """
        self._pieces.append((text, start, end))
        return len(self._pieces) - 1

    def heard(self, n_played: int) -> tuple[str, ...]:
        """Return for each piece its words that count as heard when `n_played` samples were played.

        Joined, they are the text that was heard.
        """
        return tuple(self.part(number, n_played) for number in range(len(self._pieces)))

    def part(self, number: int, n_played: int, *, is_complete: bool = True) -> str:
        """Return the words of piece `number` that count as heard after `n_played` samples.

        Pieces are texts or words of the stream, as added, with their samples where known.
        is_complete: no more samples will come. A piece without a start shares the sound of those
        before it; a word may begin in one piece and end in the next, as in the deltas of a text.
        """
        # Pieces without a start belong to the one before: all of them share its stretch of sound.
        first, end = number, number + 1
        while first > 0 and self._pieces[first][1] is None:
            first -= 1
        while end < len(self._pieces) and self._pieces[end][1] is None:
            end += 1
        texts = [each[0] for each in self._pieces[first:end]]
        text, start, n_heard = "".join(texts), self._pieces[first][1] or 0, 0
        # Each word gets its share of the samples by its letters, and is heard from its middle on.
        words = list(_WORD.finditer(text))
        letters = (len(word.group().strip()) + _MORE_LETTERS for word in words)
        shares = list(accumulate(letters, initial=0))
        per_share = (self._end(first, end, len(text), is_complete) - start) / max(1, shares[-1])
        for word, (begins, ends) in zip(words, pairwise(shares), strict=True):
            if 0 < n_played >= start + per_share * (begins + ends) / 2.0:
                n_heard = len(text) if word is words[-1] else word.end()
        # Of the text that was heard, the part that lies in the piece asked for.
        n_characters_before = sum(map(len, texts[: number - first]))
        return texts[number - first][: max(0, n_heard - n_characters_before)]

    def _end(self, first: int, stop: int, n_characters: int, is_complete: bool) -> int:
        """Return the sample at which pieces `first` to `stop` (excluded) end; at least their start.

        n_characters: of their text, by which the end is estimated where none is known.
        """
        start, end = self._pieces[first][1], self._pieces[stop - 1][2]
        usual = round(n_characters / _CHARACTERS_PER_S * self.rate_hz)
        begins = start or 0
        sound_end = self.n_samples if is_complete else max(self.n_samples, begins + usual)
        # Without a known end: until the next piece, else to the end of the sound, estimated while
        # more may come; but a single piece lasts at most twice as long as is usual.
        if end is None:
            end = (self._pieces[stop][1] or 0) if stop < len(self._pieces) else sound_end
            if start is not None and stop == first + 1:
                end = min(end, begins + round(_SLOWEST_FACTOR * usual))
        return max(begins, min(end, sound_end))
