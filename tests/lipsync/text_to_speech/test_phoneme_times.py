"""Where espeak-ng's phonemes lie in its own sound, measured in the sound alone."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt
from spoken_phonemes import closures

from lipsync.text_to_speech.espeak import Espeak
from lipsync.text_to_speech.espeak_library import PhonemeMark
from lipsync.text_to_speech.espeak_process import espeak as espeak_process
from lipsync.text_to_speech.synthesis import Voice

VOWELS = "AEIOU"


@pytest.fixture(scope="module")
def espeak():
    return Espeak()


def events(spoken, phoneme):
    return [each for each in spoken.phonemes if each.phoneme == phoneme]


def peak(spoken, start_s, end_s):
    rate_hz = spoken.sample_rate_hz
    return np.max(np.abs(spoken.samples[round(start_s * rate_hz) : round(end_s * rate_hz)]))


STOP_LETTERS = (*"ptkbd", "\N{LATIN SMALL LETTER SCRIPT G}")


def speak(espeak, text):
    """Return the speech of a text, and the times in s of espeak-ng's own marks of stops in it.

    Both are from one call: espeak-ng's sound is not the same to the sample the next time.
    """
    process, syntheses = espeak_process(), []
    synthesize = process.synthesize

    def synthesize_and_keep(*arguments):
        syntheses.append(synthesize(*arguments))
        return syntheses[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(process, "synthesize", synthesize_and_keep)
        spoken = espeak.speak(text)
    return spoken, [
        mark.sample / spoken.sample_rate_hz
        for mark in syntheses[0].marks
        if isinstance(mark, PhonemeMark) and mark.ipa.startswith(STOP_LETTERS)
    ]


@pytest.mark.parametrize(
    ("text", "phoneme", "closure_s"),
    [
        ("papa", "P", 0.038),  # between vowels
        ("attack", "T", 0.038),
        ("a cat", "K", 0.038),
        ("lamp", "P", 0.038),  # after a nasal
        ("ant", "T", 0.038),
        ("spot", "P", 0.015),  # after a fricative
        ("apt", "T", 0.040),  # after another stop
    ],
)
def test_a_voiceless_stop_begins_where_the_sound_ceases(espeak, text, phoneme, closure_s):
    spoken, bursts_s = speak(espeak, text)
    stop = events(spoken, phoneme)[-1]
    burst_s = min(burst for burst in bursts_s if burst > stop.start_s)

    assert burst_s - stop.start_s >= closure_s
    assert peak(spoken, stop.start_s + 0.001, burst_s - 0.003) < 0.002
    assert peak(spoken, stop.start_s - 0.010, stop.start_s + 0.001) >= 0.002


@pytest.mark.parametrize(
    ("text", "phoneme"), [("a bay", "B"), ("a day", "D"), ("a game", "G"), ("a bee", "B")]
)
def test_a_voiced_stop_holds_its_murmur(espeak, text, phoneme):
    spoken = espeak.speak(text)
    (stop,) = events(spoken, phoneme)

    assert 0.025 <= stop.end_s - stop.start_s <= 0.12
    # The vowel after it is louder than the murmur at once.
    assert peak(spoken, stop.end_s, stop.end_s + 0.02) > peak(
        spoken, stop.start_s + 0.01, stop.start_s + 0.03
    )


@pytest.mark.parametrize("text", ["No. Pa", "No. Ba", "No. Ta", "No. Ga"])
def test_after_a_pause_a_closure_is_90_ms_long(espeak, text):
    spoken, bursts_s = speak(espeak, text)
    stop = spoken.phonemes[-3]

    assert spoken.phonemes[-4].phoneme == "SIL"
    assert bursts_s[-1] - stop.start_s == pytest.approx(0.09, abs=1e-6)


def test_at_the_beginning_of_the_sound_a_closure_begins_with_it(espeak):
    assert espeak.speak("papa").phonemes[0].phoneme == "P"


@pytest.mark.parametrize(
    ("text", "n"),
    [("papa mama baby", 6), ("Peter picked a pepper", 4), ("thumbs up", 2), ("camp bed", 1)],
)
def test_the_lips_have_time_to_close(espeak, text, n):
    found = closures(espeak.speak(text))

    assert len(found) == n
    assert min(end_s - start_s for start_s, end_s in found) > 0.03


def murmur_ends_s(spoken):
    """Yield the end of each M before a vowel in s: (by its event, by the sound).

    By the sound: where the level above 1 kHz, in dB, is half way from that of the M to the vowel's.
    """
    rate_hz = spoken.sample_rate_hz
    high = sosfiltfilt(butter(4, 1000, "hp", fs=rate_hz, output="sos"), spoken.samples)
    window = round(0.008 * rate_hz)
    level_db = 10 * np.log10(np.convolve(high**2, np.ones(window) / window, "same") + 1e-9)
    for event, following in pairwise(spoken.phonemes):
        if event.phoneme == "M" and following.phoneme[0] in VOWELS:
            place = [round(each * rate_hz) for each in (event.start_s + 0.01, following.end_s)]
            vowel = round((following.start_s + 0.02) * rate_hz)
            murmur_db = np.median(level_db[place[0] : place[0] + round(0.015 * rate_hz)])
            vowel_db = np.median(level_db[vowel : vowel + round(0.03 * rate_hz)])
            above = np.nonzero(level_db[place[0] : place[1]] > (murmur_db + vowel_db) / 2)[0]
            if vowel_db - murmur_db > 8:
                yield event.end_s, (place[0] + above[0]) / rate_hz


@pytest.mark.parametrize("rate_wpm", [100, 175, 300])
def test_a_nasal_ends_where_its_murmur_ends(espeak, rate_wpm):
    text = "My mother made more muffins for Mamie, and many men met Emma in Miami."
    ends = list(murmur_ends_s(espeak.speak(text, Voice(rate_wpm=rate_wpm))))
    errors_ms = [1000 * (told - heard) for told, heard in ends]

    assert len(ends) >= 5
    assert abs(np.median(errors_ms)) < 4
    assert np.max(np.abs(errors_ms)) < 25
