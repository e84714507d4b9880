"""The synthesiser espeak-ng: a hundred languages, with the time of every phoneme.

Why espeak-ng, and what its times are worth: docs/decisions/speech-out.md.

The times of its phonemes ("events") are corrected by its own sound. Measured on version 1.51
(docs/speech.md, times): most events are right to the millisecond. Two kinds are not.

- The event of a stop or an affricate lies at its burst. The closure before it, silent but where it
  is voiced, counts to the phoneme before: here the onset is moved back over it.
- The event of a vowel after a nasal or a voiced stop lies late, by 19 ms after an M, as its
  transition is counted to the consonant: here it is moved back to where the sound jumps.
"""

import difflib
import re
import string
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lipsync.ipa import phones_of_ipa
from lipsync.phonemes import SILENCE
from lipsync.text_to_speech.espeak_library import PhonemeMark, Synthesis, WordMark
from lipsync.text_to_speech.espeak_process import espeak
from lipsync.text_to_speech.synthesis import (
    DEFAULT_VOICE,
    SpokenWord,
    SynthesisError,
    SynthesizedSpeech,
    TimedPhones,
    UnspeakableTextError,
    Voice,
    checked_text,
    phoneme_events,
    word_times,
)

_STOPS = frozenset(("P", "B", "T", "D", "K", "G", "CH", "JH"))
_RELEASED = frozenset(("M", "N", "NG", "B", "D", "G"))
_VOWELS = frozenset(
    ("AA", "AE", "AH", "AO", "AW", "AY", "EH", "ER", "EY", "IH", "IY", "OW", "OY", "UH", "UW")
)

#: Amplitudes below it are silence: espeak-ng's pauses and closures are zero to the last bit or two.
_SILENT = 0.002
#: A burst may begin this long before its event.
_BURST_EARLY_S = 0.003
#: After a pause the start of a closure cannot be heard; lips close about so long before the burst.
_CLOSURE_AFTER_PAUSE_S = 0.09
#: A vowel's onset is searched in this last share of the consonant before it. At 120 words a minute
#: the onset was up to 63 ms before its event, in the last half of an M.
_ONSET_SHARE = 0.6
#: The onset is not looked for this near to the beginning of the consonant, or to its burst.
_CONSONANT_AT_LEAST_S = 0.015
#: The two stretches whose loudness is compared, and the least rise between them that is a release.
_COMPARED_S, _STEP_S, _LEAST_RISE_DB = 0.008, 0.001, 6.0
#: A phoneme without duration sounds within the one before: its share of that one's time.
_SHARE_OF_JOINED = 1 / 3


def refine_times(
    phonemes: list[TimedPhones], samples: NDArray[np.float32], sample_rate_hz: int
) -> list[TimedPhones]:
    """Return the phonemes with espeak-ng's times corrected by the sound, in order, without gaps.

    Parameters
    ----------
    phonemes : list[TimedPhones]
        Phonemes with espeak-ng's times.
    samples : NDArray[np.float32]
        (n,).
    sample_rate_hz : int
        Rate of the samples.

    Returns
    -------
    list[TimedPhones]
        Times in seconds.
    """
    timed = _give_durations(phonemes)
    events_s = [each.start_s for each in timed]
    loud_s = np.flatnonzero(np.abs(samples) >= _SILENT) / sample_rate_hz
    edges = np.diff(samples, prepend=samples[:1])
    for index in range(1, len(timed)):
        before, after = timed[index - 1], timed[index]
        # A stop begins where the silence before its burst begins, a vowel where the sound jumps.
        if after.phones[0] in _STOPS:
            if before.phones[-1] == SILENCE:
                earliest_s = max(before.start_s, after.start_s - _CLOSURE_AFTER_PAUSE_S)
            else:
                earliest_s = min(events_s[index - 1] + _CONSONANT_AT_LEAST_S, after.start_s)
            boundary_s = max(earliest_s, _closure_start_s(after.start_s, loud_s))
        elif after.phones[0] in _VOWELS and before.phones[-1] in _RELEASED:
            consonant_s = after.start_s - events_s[index - 1]
            earliest_s = max(
                events_s[index - 1] + _CONSONANT_AT_LEAST_S,
                after.start_s - _ONSET_SHARE * consonant_s,
            )
            boundary_s = _release_s(after.start_s, earliest_s, edges, sample_rate_hz)
        else:
            continue
        before.end_s = after.start_s = boundary_s
    return [each for each in timed if each.end_s > each.start_s]


def _give_durations(phonemes: list[TimedPhones]) -> list[TimedPhones]:
    """Return copies of phonemes; one without duration gets the last third of the one before it.

    Beside silence a phoneme without duration is left out.
    """
    with_durations: list[TimedPhones] = []
    for phoneme in phonemes:
        phoneme = replace(phoneme)
        if phoneme.start_s == phoneme.end_s:
            if not with_durations or SILENCE in (phoneme.phones[0], with_durations[-1].phones[0]):
                continue
            before = with_durations[-1]
            phoneme.start_s -= _SHARE_OF_JOINED * (before.end_s - before.start_s)
            before.end_s = phoneme.start_s
        with_durations.append(phoneme)
    return with_durations


def _closure_start_s(burst_s: float, loud_s: NDArray[np.float64]) -> float:
    """Return when the silence that ends with a burst began; the burst's time if there is none.

    loud_s: times of all samples that are not silent, rising.
    """
    n_before = int(np.searchsorted(loud_s, burst_s - _BURST_EARLY_S))
    start_s = float(loud_s[n_before - 1]) if n_before else 0.0
    return start_s if start_s < burst_s - 2 * _BURST_EARLY_S else burst_s


def _release_s(
    event_s: float, earliest_s: float, edges: NDArray[np.float32], sample_rate_hz: int
) -> float:
    """Return when the sound rises most between `earliest_s` and a vowel's start by espeak-ng.

    event_s: that start; returned if the sound does not rise enough. edges: differences of
    successive samples, which weigh the higher formants, let out by an open mouth, above the murmur
    of a closed one.
    """
    n_compared = round(_COMPARED_S * sample_rate_hz)
    best_s, best_rise_db = event_s, _LEAST_RISE_DB
    for time_s in np.arange(earliest_s, event_s, _STEP_S):
        place = round(float(time_s) * sample_rate_hz)
        left, right = edges[max(0, place - n_compared) : place], edges[place : place + n_compared]
        if len(left) and len(right):
            rise_db = _level_db(right) - _level_db(left)
            if rise_db > best_rise_db:
                best_s, best_rise_db = float(time_s), rise_db
    return best_s


def _level_db(values: NDArray[np.float32]) -> float:
    return float(10.0 * np.log10(np.mean(np.square(values, dtype=np.float64)) + 1e-9))


#: From 450 on espeak-ng squeezes its sound afterwards, and its events no longer fit the sound.
_RATES_WPM = range(80, 401)
_PITCHES = range(100)
_WORD = re.compile(r"\w+")
#: How a phoneme like "(fr)" begins, by which espeak-ng marks another language. It has no sound.
_SWITCH = "("
#: A pause of which a larger share sounds belongs to the phoneme before it.
_SOUNDING_SHARE = 0.5


class Espeak:
    """The speech `Synthesizer` espeak-ng. Raises SynthesisError where it is not installed."""

    longest_text = 5000

    def __init__(self) -> None:
        self._process = espeak()

    def languages(self) -> tuple[str, ...]:
        """Return the language tags of espeak-ng, such as `en-us`, `de`, `pt-br`."""
        return self._process.languages()

    def voices(self) -> tuple[str, ...]:
        """Return an empty tuple: espeak-ng has one voice for each language."""
        return ()

    def speak(self, text: str, voice: Voice = DEFAULT_VOICE) -> SynthesizedSpeech:
        """Return a text's speech with phoneme and word times. Raises SynthesisError."""
        written = checked_text(text, self.longest_text)
        self._check_voice(voice)
        spoken = self._process.synthesize(written, voice)
        phonemes, guessed = _timed_phones(spoken)
        if all(each.phones == (SILENCE,) for each in phonemes):
            raise UnspeakableTextError(
                f"{written[:40]!r} has nothing that can be spoken in {voice.language!r}; write "
                "words"
            )
        timed = refine_times(phonemes, spoken.samples, spoken.sample_rate_hz)
        return SynthesizedSpeech(
            spoken.samples,
            spoken.sample_rate_hz,
            phoneme_events(timed),
            _timed_words(written, spoken, timed),
            guessed,
        )

    def _check_voice(self, voice: Voice) -> None:
        """Raise SynthesisError for a named voice, and a language, rate or pitch not available."""
        if voice.name:
            raise SynthesisError(f"espeak-ng has no voice {voice.name!r}; give a language")
        known = self._process.languages()
        if voice.language not in known:
            near = difflib.get_close_matches(voice.language, known, 3, 0.0)
            raise SynthesisError(
                f"espeak-ng does not speak {voice.language!r}; similar languages: {', '.join(near)}"
            )
        if voice.rate_wpm not in _RATES_WPM:
            raise SynthesisError(f"rate {voice.rate_wpm} is not within 80 to 400 words a minute")
        if voice.pitch not in _PITCHES:
            raise SynthesisError(f"pitch {voice.pitch} is not within 0 to 99")


def _timed_phones(spoken: Synthesis) -> tuple[list[TimedPhones], tuple[str, ...]]:
    """Return phones from 0 to the end of the sound without gaps, and the IPA phonemes guessed.

    A guessed phoneme is missing in the table of IPA phonemes and replaced by a similar one.
    """
    duration_s = len(spoken.samples) / spoken.sample_rate_hz
    timed = [TimedPhones((SILENCE,), 0.0, duration_s)]
    guessed: dict[str, None] = {}
    word = -1
    for mark, end in _with_ends(spoken):
        if isinstance(mark, WordMark):
            word += 1
            continue
        phones = phones_of_ipa(mark.ipa)
        if phones.is_guess:
            guessed[mark.ipa] = None
        # For a mark of length alone, or a pause that sounds, the last phoneme continues.
        if not phones.phones and (mark.ipa or _is_audible(spoken.samples[mark.sample : end])):
            continue
        start_s = min(mark.sample / spoken.sample_rate_hz, duration_s)
        last = timed[-1]
        if not phones.phones and last.phones == (SILENCE,):
            continue
        last.end_s = start_s
        timed.append(
            TimedPhones(phones.phones, start_s, duration_s, word)
            if phones.phones
            else TimedPhones((SILENCE,), start_s, duration_s)
        )
    return timed, tuple(guessed)


def _with_ends(spoken: Synthesis) -> list[tuple[PhonemeMark | WordMark, int]]:
    """Return each mark with the sample of the next phoneme's mark, or of the sound's end.

    Marks that switch the language are left out.
    """
    result: list[tuple[PhonemeMark | WordMark, int]] = []
    end = len(spoken.samples)
    for mark in reversed(spoken.marks):
        if isinstance(mark, PhonemeMark) and mark.ipa.startswith(_SWITCH):
            continue
        result.append((mark, end))
        if isinstance(mark, PhonemeMark):
            end = mark.sample
    return result[::-1]


def _is_audible(samples: NDArray[np.float32]) -> bool:
    """Return whether more than half of the samples (n,) are not silent."""
    return len(samples) > 0 and float(np.mean(np.abs(samples) >= _SILENT)) > _SOUNDING_SHARE


def _timed_words(text: str, spoken: Synthesis, timed: list[TimedPhones]) -> tuple[SpokenWord, ...]:
    """Return the words of `text` that are spoken, with start and end in seconds.

    timed: the phonemes, with corrected times. Words that espeak-ng counts within one written word
    (syllables, parts of a number) are joined.
    """
    marks = [mark for mark in spoken.marks if isinstance(mark, WordMark)]
    words: list[SpokenWord] = []
    written_end = 0
    for index, (start_s, end_s) in word_times(timed).items():
        mark = marks[index]
        if words and mark.position < written_end:
            # Syllables of a script without spaces, and parts of a number: within the last word.
            words[-1] = replace(words[-1], end_s=end_s)
            continue
        written_end = mark.position + mark.length
        word = text[mark.position : mark.position + mark.length].strip()
        if all(sign in string.punctuation for sign in word):
            # espeak-ng counts "-- How" as two words, and gives the time of "How" to the first.
            following = _WORD.search(text, max(0, mark.position))
            word = following.group() if following is not None else ""
        if word:
            words.append(SpokenWord(word, start_s, end_s))
    return tuple(words)
