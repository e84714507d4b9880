"""What a speech synthesiser makes of a text, and what every synthesiser here can do."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lipsync.errors import UserError
from lipsync.phonemes import PhonemeEvent


class SynthesisError(UserError):
    """A text cannot be spoken: what, why, and what to do, in one line."""


class UnspeakableTextError(SynthesisError):
    """A text holds nothing that sounds: empty, dashes, signs that the voice does not read."""


@dataclass(frozen=True, slots=True)
class Voice:
    """How to speak. What a synthesiser lacks it refuses with SynthesisError.

    language: one of the synthesiser's `languages()`. name: one of its `voices()`; "" is its own
    choice for the language. rate_wpm: words a minute, 80 to 400, 175 as the voice was made.
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
    """A word as it stands in the text, from its first phoneme to the end of its last."""

    text: str
    start_s: float
    end_s: float


@dataclass(frozen=True, slots=True)
class SpokenText:
    """Sound and what is said in it; times in seconds from the first sample.

    samples: float32 (n,), within [-1, 1]. phonemes: of our inventory, in order, each beginning
    where the one before ends, SIL in pauses, from 0 to the end of the sound. A stop holds its
    closure. guessed: phonemes of the voice that lipsync/ipa.yaml lacks, each once.
    """

    samples: NDArray[np.float32]
    sample_rate_hz: int
    phonemes: tuple[PhonemeEvent, ...]
    words: tuple[SpokenWord, ...]
    guessed: tuple[str, ...] = ()

    @property
    def duration_s(self) -> float:
        """How long it sounds."""
        return len(self.samples) / self.sample_rate_hz


class Synthesizer(Protocol):
    """A speech synthesiser that tells when it says what."""

    #: Texts longer than this, in characters, are to be cut (`speak_in_pieces` does).
    longest_text: int

    def languages(self) -> tuple[str, ...]:
        """The languages that it speaks, in alphabetical order."""

    def voices(self) -> tuple[str, ...]:
        """The names of its voices, in alphabetical order; none where a language is a voice."""

    def speak(self, text: str, voice: Voice = DEFAULT_VOICE) -> SpokenText:
        """Speak a text of at most `longest_text` characters.

        Text is text: marks of SSML are read out as they stand. Raises SynthesisError for a text in
        which nothing can be spoken (UnspeakableTextError), and for a voice that it lacks.
        """
