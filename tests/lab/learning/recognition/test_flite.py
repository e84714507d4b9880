"""flite by its command: segments with times, and what it refuses."""

from itertools import pairwise

import numpy as np
import pytest
from lipservo_lab.learning.recognition.flite import Flite, segments
from spoken_phonemes import check_spoken, closures

from lipsync.text_to_speech.synthesis import (
    SynthesisError,
    TimedPhones,
    UnspeakableTextError,
    Voice,
)


@pytest.fixture(scope="module")
def flite():
    try:
        return Flite()
    except SynthesisError as error:
        pytest.skip(str(error))


def level_db(spoken, start_s, end_s):
    place = slice(round(start_s * spoken.sample_rate_hz), round(end_s * spoken.sample_rate_hz))
    return 10 * np.log10(np.mean(np.square(spoken.samples[place], dtype=float)) + 1e-9)


@pytest.mark.parametrize("name", ["kal", "rms", "slt"])
def test_every_voice_says_the_same_and_closes_its_lips(flite, name):
    spoken = flite.speak("papa mama baby", Voice(name=name))

    check_spoken(spoken)
    said = " ".join(each.phoneme for each in spoken.phonemes)
    assert said == "SIL P AA P AH M AA M AH B EY B IY SIL"
    assert len(closures(spoken)) == 6
    assert min(end_s - start_s for start_s, end_s in closures(spoken)) > 0.04
    # The middle of a vowel is louder than the beginning of the P before it: its closure.
    for event, following in pairwise(spoken.phonemes):
        if event.phoneme == "P":
            closure_db = level_db(spoken, event.start_s + 0.03, event.start_s + 0.05)
            middle_s = (following.start_s + following.end_s) / 2
            assert level_db(spoken, middle_s - 0.01, middle_s + 0.01) > closure_db + 6


def test_a_slower_voice_takes_longer(flite):
    plain = flite.speak("a baby")
    assert flite.speak("a baby", Voice(rate_wpm=100)).duration_s > 1.4 * plain.duration_s


def test_the_last_pause_ends_with_the_sound():
    said = segments("pau:0.2 hh:0.3 ax:0.35 pau:0.6 \n", 0.5)
    assert said == [
        TimedPhones(("SIL",), 0.0, 0.2),
        TimedPhones(("HH",), 0.2, 0.3),
        TimedPhones(("AH",), 0.3, 0.35),
        TimedPhones(("SIL",), 0.35, 0.5),
    ]
    assert segments("ax:0.1 \n", 0.5)[-1] == TimedPhones(("SIL",), 0.1, 0.5)


@pytest.mark.parametrize("printed", ["usage: flite", "ax", "zz:0.1", "ax:soon"])
def test_a_print_of_another_kind_is_refused(printed):
    with pytest.raises(SynthesisError, match="no segment"):
        segments(printed, 1.0)


@pytest.mark.parametrize("text", ["", "\x00\x07", "...", "--"])
def test_a_text_in_which_nothing_can_be_spoken_is_one_line(flite, text):
    with pytest.raises(UnspeakableTextError):
        flite.speak(text)


@pytest.mark.parametrize(
    "text", ["-voice kal", "<speak>no</speak>", "a \U0001f600 caf\u00e9", "$(a)"]
)
def test_text_is_text_whatever_it_looks_like(flite, text):
    check_spoken(flite.speak(text))


@pytest.mark.parametrize(
    ("voice", "told"),
    [
        (Voice("de"), "'en-us' alone"),
        (Voice(name="/etc/passwd"), "it has: awb, kal, kal16, rms, slt"),
        (Voice(rate_wpm=1), "80 to 400"),
        (Voice(pitch=60), "one pitch"),
    ],
)
def test_a_voice_that_it_lacks_is_one_line(flite, voice, told):
    with pytest.raises(SynthesisError, match=told):
        flite.speak("hello", voice)


def test_a_missing_command_is_one_line_that_names_the_package(monkeypatch):
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(SynthesisError, match="flite is not installed: `apt install flite`"):
        Flite()
