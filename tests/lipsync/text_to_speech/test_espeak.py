"""espeak-ng through its library: what it says, when, and what it does with odd texts."""

import numpy as np
import pytest

from lipsync.phonemes import PHONEMES
from lipsync.text_to_speech.espeak import Espeak

STOPS = ("P", "B", "T", "D", "K", "G")
LIPS_CLOSED = ("P", "B", "M")


@pytest.fixture(scope="module")
def espeak():
    return Espeak()


def said(spoken, *phonemes):
    """The events of these phonemes, in order."""
    return [each for each in spoken.phonemes if each.phoneme in phonemes]


def level_db(spoken, start_s, end_s):
    place = slice(round(start_s * spoken.sample_rate_hz), round(end_s * spoken.sample_rate_hz))
    return 10 * np.log10(np.mean(np.square(spoken.samples[place], dtype=float)) + 1e-12)


def check_events(spoken):
    events = spoken.phonemes
    assert events[0].start_s == 0.0
    assert events[-1].end_s == pytest.approx(spoken.duration_s)
    for event in events:
        assert event.phoneme in PHONEMES
        assert event.end_s > event.start_s
    for before, after in zip(events, events[1:], strict=False):
        assert before.end_s == after.start_s
        assert (before.phoneme, after.phoneme) != ("SIL", "SIL")
    assert spoken.samples.dtype == np.float32
    assert np.all(np.isfinite(spoken.samples))
    assert np.max(np.abs(spoken.samples)) <= 1.0


def test_a_sentence_is_said_phoneme_by_phoneme(espeak):
    spoken = espeak.speak("thumbs up")

    check_events(spoken)
    assert [each.phoneme for each in spoken.phonemes] == [
        *("SIL", "TH", "AH", "M", "Z", "AH", "P", "SIL")
    ]
