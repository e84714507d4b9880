"""The protocol of speech synthesisers, the texts given to them, and the speech that they make."""

import re
import unicodedata
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np
from numpy.typing import NDArray

from lipsync.errors import UserError
from lipsync.phonemes import SILENCE, PhonemeEvent
from lipsync.spoken_text import SpokenText


class SynthesisError(UserError):
    """Error for a text that cannot be spoken: what, why, and what to do, in one line."""


class UnspeakableTextError(SynthesisError):
    """Error for a text without sound: empty, dashes, signs that the voice does not read."""


SLOWEST_WPM: Final = 80
FASTEST_WPM: Final = 400
HIGHEST_PITCH: Final = 99


@dataclass(frozen=True, slots=True)
class Voice:
    """Language, voice, rate and pitch; a synthesiser that lacks one raises SynthesisError.

    language: one of the synthesiser's `languages()`. name: one of its `voices()`; "" leaves the
    choice for the language to it. rate_wpm: words a minute, 80 to 400, 175 as the voice was made.
    pitch: 0 to 99, 50 as the voice was made.
    """

    language: str = "en-us"
    name: str = ""
    rate_wpm: int = 175
    pitch: int = 50


#: American English, as the voice was made.
DEFAULT_VOICE = Voice()


@dataclass(frozen=True, slots=True)
class SpokenWord:
    """A word of a spoken text: start of its first phoneme and end of its last, in seconds."""

    text: str
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class SynthesizedSpeech:
    """Sound with its phonemes or units; times in seconds from the first sample.

    samples: float32 (n,), within [-1, 1]. phonemes: of our inventory, in order, each beginning
    where the one before ends, SIL in pauses, from 0 to the end of the sound; a stop includes its
    closure. units: None with phonemes; for a voice without phoneme times it is the text, phonemes
    without times, or words with their starts. guessed: phonemes of the voice that lipsync/ipa.yaml
    lacks, each once.
    """

    samples: NDArray[np.float32]
    sample_rate_hz: int
    phonemes: tuple[PhonemeEvent, ...]
    words: tuple[SpokenWord, ...]
    guessed: tuple[str, ...] = ()
    units: SpokenText | None = None

    @property
    def duration_s(self) -> float:
        """The duration of the sound in seconds."""
        return len(self.samples) / self.sample_rate_hz


class Synthesizer(Protocol):
    """A speech synthesiser, from text to sound with words or phonemes, mostly with their times."""

    #: Texts longer than this, in characters, are to be cut (`speak_in_pieces` does).
    longest_text: int

    def languages(self) -> tuple[str, ...]:
        """Return the synthesiser's languages in alphabetical order; () if the voice has its own."""

    def voices(self) -> tuple[str, ...]:
        """Return the voices' names in alphabetical order; () if there is no list of them."""

    def speak(self, text: str, voice: Voice = DEFAULT_VOICE) -> SynthesizedSpeech:
        """Return the speech of a text of at most `longest_text` characters.

        Marks of SSML are read out literally. Raises UnspeakableTextError for a text in which
        nothing can be spoken, SynthesisError for a longer text or a voice that is lacking.
        """


#: Control characters (espeak-ng would obey some), half a surrogate pair, unassigned code points.
_NOT_TEXT = ("Cc", "Cs", "Cn")
#: What ends a sentence, with the brackets and quotation marks that close after it.
_SENTENCE_END = re.compile(r"[.!?…;:。！？।]+[\"'”’»)\]]*(?=\s)|[。！？।]|\n\s*\n")
#: A full stop after such a word ends no sentence: titles, initials, U.S., z.B.
_ABBREVIATION = re.compile(
    r"(?:^|\s)(?:Mrs?|Ms|Dr|St|Prof|Jr|Sr|vs|(?:[A-Za-z]\.)*[A-Z]|[a-z]\.[a-zA-Z])\.$"
)
_PAUSE = re.compile(r"[,–—、，]\s*")
_SPACE = re.compile(r"\s+")


def readable(text: str) -> str:
    """Return the text with a space for each control or unassigned character, equally long."""
    return "".join(" " if unicodedata.category(each) in _NOT_TEXT else each for each in text)


def checked_text(text: str, longest: int) -> str:
    """Return the text with a space for each control or unassigned character, equally long.

    Raises UnspeakableTextError for an empty text, SynthesisError for one longer than `longest`.
    """
    if len(text) > longest:
        raise SynthesisError(
            f"a text of {len(text)} characters is too long to be spoken at once; "
            f"at most {longest}, or speak it in pieces"
        )
    written = readable(text)
    if not written.strip():
        raise UnspeakableTextError("the text is empty; write words to speak")
    return written


def pieces(text: str, longest: int) -> Iterator[str]:
    """Yield the sentences of a text; one longer than `longest` is cut at a comma or a space.

    White space alone gives no piece. A word longer than `longest` characters is cut there.
    """
    start = 0
    while start < len(text):
        end = _piece_end(text, start, longest)
        piece = text[start:end].strip()
        if piece:
            yield piece
        start = end


def _piece_end(text: str, start: int, longest: int) -> int:
    """Return the index in `text` of the end of the piece that begins at `start`.

    The first that applies: the next end of a sentence, the end of the text, the last comma, the
    last space, `longest` characters.
    """
    window = text[start : start + longest + 1]
    for match in _SENTENCE_END.finditer(window):
        if not _ABBREVIATION.search(window[: match.end()]):
            return start + match.end()
    if len(window) <= longest:
        return len(text)
    for separator in (_PAUSE, _SPACE):
        ends = [match.end() for match in separator.finditer(window[:longest])]
        if ends:
            return start + ends[-1]
    return start + longest


@dataclass(slots=True)
class TimedPhones:
    """A voice's phoneme as phones of the inventory; `word`: number of its word, -1 for none."""

    phones: tuple[str, ...]
    start_s: float
    end_s: float
    word: int = -1


def phoneme_events(timed: list[TimedPhones]) -> tuple[PhonemeEvent, ...]:
    """Return one event for each phone, in order.

    The phones of one phoneme share its time evenly; successive pauses become one event.
    """
    events: list[PhonemeEvent] = []
    for each in timed:
        n = len(each.phones)
        bounds_s = [each.start_s + index * (each.end_s - each.start_s) / n for index in range(n)]
        for phone, start_s, end_s in zip(
            each.phones, bounds_s, [*bounds_s[1:], each.end_s], strict=True
        ):
            if phone == SILENCE and events and events[-1].phoneme == SILENCE:
                start_s = events.pop().start_s
            events.append(PhonemeEvent(phone, start_s, end_s))
    return tuple(events)


def word_times(timed: list[TimedPhones]) -> dict[int, tuple[float, float]]:
    """Return the start and end in seconds of each word's phonemes, by the number of the word."""
    times_s: dict[int, tuple[float, float]] = {}
    for each in timed:
        if each.word >= 0:
            start_s, _ = times_s.get(each.word, (each.start_s, 0.0))
            times_s[each.word] = (start_s, each.end_s)
    return times_s
