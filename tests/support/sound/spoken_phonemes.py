"""Phonemes as a test, a recogniser and a synthesiser say them."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import strategies as st

from lipsync.phonemes import PHONEMES, PhonemeEvent, PhonemeUpdate


def spoken(*phones: tuple[str, float]) -> tuple[PhonemeEvent, ...]:
    """Events one after the other from their durations."""
    events, start_s = [], 0.0
    for phoneme, duration_s in phones:
        events.append(PhonemeEvent(phoneme, start_s, start_s + duration_s))
        start_s += duration_s
    return tuple(events)


@st.composite
def update_streams(draw) -> list[PhonemeUpdate]:
    """Beliefs that change, come late, in bursts, and contradict one another."""
    updates, heard_s = [], 0.0
    for _ in range(draw(st.integers(1, 12))):
        heard_s += draw(st.floats(0.01, 0.5))
        start_s = max(0.0, heard_s - draw(st.floats(0.0, 0.8)))
        final_s = max(0.0, heard_s - draw(st.floats(0.0, 0.6)))
        events, at_s = [], start_s
        for phoneme in draw(st.lists(st.sampled_from(PHONEMES), min_size=1, max_size=5)):
            end_s = at_s + draw(st.floats(0.005, 0.4))
            events.append(PhonemeEvent(phoneme, at_s, end_s))
            at_s = end_s
        if draw(st.booleans()):
            events[-1] = PhonemeEvent(events[-1].phoneme, events[-1].start_s, None)
        updates.append(PhonemeUpdate(start_s, heard_s, final_s, tuple(events)))
    return updates


def check_spoken(spoken):
    """What holds of every `SynthesizedSpeech`.

    Its phonemes are of the inventory and cover the sound without gaps; the sound is in full scale.
    """
    events = spoken.phonemes
    assert events[0].start_s == 0.0
    assert events[-1].end_s == pytest.approx(spoken.duration_s)
    for event in events:
        assert event.phoneme in PHONEMES
        assert event.end_s > event.start_s
    for before, after in pairwise(events):
        assert before.end_s == after.start_s
        assert (before.phoneme, after.phoneme) != ("SIL", "SIL")
    for word in spoken.words:
        assert 0.0 <= word.start_s < word.end_s <= spoken.duration_s
    assert spoken.samples.dtype == np.float32
    assert np.all(np.isfinite(spoken.samples))
    assert np.max(np.abs(spoken.samples)) <= 1.0


def closures(spoken):
    """(start_s, end_s) of each stretch of P B M: in a row they are one, the lips stay shut."""
    found = []
    for event in spoken.phonemes:
        if event.phoneme in ("P", "B", "M"):
            if found and found[-1][1] == event.start_s:
                found[-1] = (found[-1][0], event.end_s)
            else:
                found.append((event.start_s, event.end_s))
    return found
