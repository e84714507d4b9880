"""espeak-ng speaks: a hundred languages, with the time of every phoneme.

Why espeak-ng, and what its times are worth: docs/decisions/0018-text-to-speech.md.
"""

import difflib
import re
import string

import numpy as np
from numpy.typing import NDArray

from lipsync.ipa import phones_of_ipa
from lipsync.phonemes import SILENCE
from lipsync.text_to_speech.espeak_library import (
    PhonemeMark,
    Synthesis,
    WordMark,
    espeak_library,
)
from lipsync.text_to_speech.phoneme_times import refined
from lipsync.text_to_speech.spoken_text import (
    DEFAULT_VOICE,
    SpokenText,
    SpokenWord,
    SynthesisError,
    UnspeakableTextError,
    Voice,
)
from lipsync.text_to_speech.timed_phones import TimedPhones, phoneme_events, word_times
from lipsync.text_to_speech.written_text import checked_text

#: From 450 on espeak-ng squeezes its sound afterwards, and its events no longer fit the sound.
_RATES_WPM = range(80, 401)
_PITCHES = range(100)
_WORD = re.compile(r"\w+")
#: espeak-ng says with a phoneme like "(fr)" that another language begins. No sound.
_SWITCH = "("
#: A pause of espeak-ng's of which more than this sounds is the end of the phoneme before.
_SOUNDING_SHARE, _SILENT = 0.5, 0.002


class Espeak:
    """The `Synthesizer` espeak-ng. Raises SynthesisError where it is not installed."""

    longest_text = 5000

    def __init__(self) -> None:
        self._library = espeak_library()

    def languages(self) -> tuple[str, ...]:
        """Language tags as espeak-ng has them: `en-us`, `de`, `pt-br`."""
        return self._library.languages()

    def voices(self) -> tuple[str, ...]:
        """None: a language is a voice."""
        return ()

    def speak(self, text: str, voice: Voice = DEFAULT_VOICE) -> SpokenText:
        """See `Synthesizer`; one text at a time in a process, others wait."""
        written = checked_text(text, self.longest_text)
        self._check_voice(voice)
        spoken = self._library.synthesize(written, voice)
        phonemes, guessed = _timed_phones(spoken)
        if all(each.phones == (SILENCE,) for each in phonemes):
            raise UnspeakableTextError(
                f"{written[:40]!r} holds nothing that can be spoken in {voice.language!r}; "
                "write words"
            )
        timed = refined(phonemes, spoken.samples, spoken.sample_rate_hz)
        return SpokenText(
            spoken.samples,
            spoken.sample_rate_hz,
            phoneme_events(timed),
            _words(written, spoken, timed),
            guessed,
        )

    def _check_voice(self, voice: Voice) -> None:
        if voice.name:
            raise SynthesisError(f"espeak-ng has no voice {voice.name!r}; choose a language")
        known = self._library.languages()
        if voice.language not in known:
            near = difflib.get_close_matches(voice.language, known, 3, 0.0)
            raise SynthesisError(
                f"espeak-ng does not speak {voice.language!r}; near it: {', '.join(near)}"
            )
        if voice.rate_wpm not in _RATES_WPM:
            raise SynthesisError(f"rate {voice.rate_wpm} is not within 80 to 400 words a minute")
        if voice.pitch not in _PITCHES:
            raise SynthesisError(f"pitch {voice.pitch} is not within 0 to 99")


def _timed_phones(spoken: Synthesis) -> tuple[list[TimedPhones], tuple[str, ...]]:
    """What the marks say, from 0 to the end of the sound without gaps, and what was guessed."""
    duration_s = len(spoken.samples) / spoken.sample_rate_hz
    found = [TimedPhones((SILENCE,), 0.0, duration_s)]
    guessed: dict[str, None] = {}
    word = -1
    for mark, end in _with_ends(spoken):
        if isinstance(mark, WordMark):
            word += 1
            continue
        phones = phones_of_ipa(mark.ipa)
        if phones.is_guess:
            guessed[mark.ipa] = None
        # A mark of length alone, or what is called a pause but sounds, goes on with the last one.
        if not phones.phones and (mark.ipa or _sounds(spoken.samples[mark.sample : end])):
            continue
        start_s = min(mark.sample / spoken.sample_rate_hz, duration_s)
        last = found[-1]
        if not phones.phones and last.phones == (SILENCE,):
            continue
        last.end_s = start_s
        is_pause = not phones.phones
        found.append(
            TimedPhones(
                (SILENCE,) if is_pause else phones.phones,
                start_s,
                duration_s,
                -1 if is_pause else word,
            )
        )
    return found, tuple(guessed)


def _with_ends(spoken: Synthesis) -> list[tuple[PhonemeMark | WordMark, int]]:
    """Each mark but switches of language, and the sample where the next phoneme's mark lies."""
    result: list[tuple[PhonemeMark | WordMark, int]] = []
    end = len(spoken.samples)
    for mark in reversed(spoken.marks):
        if isinstance(mark, PhonemeMark):
            if mark.ipa.startswith(_SWITCH):
                continue
            result.append((mark, end))
            end = mark.sample
        else:
            result.append((mark, end))
    return result[::-1]


def _sounds(samples: NDArray[np.float32]) -> bool:
    return len(samples) > 0 and float(np.mean(np.abs(samples) >= _SILENT)) > _SOUNDING_SHARE


def _words(text: str, spoken: Synthesis, timed: list[TimedPhones]) -> tuple[SpokenWord, ...]:
    marks = [mark for mark in spoken.marks if isinstance(mark, WordMark)]
    found = []
    for index, (start_s, end_s) in word_times(timed).items():
        mark = marks[index]
        word = text[mark.position : mark.position + mark.length].strip()
        if all(sign in string.punctuation for sign in word):
            # espeak-ng counts "-- How" as two words, and says that it speaks the first of them.
            following = _WORD.search(text, max(0, mark.position))
            word = following.group() if following is not None else ""
        if word:
            found.append(SpokenWord(word, start_s, end_s))
    return tuple(found)
