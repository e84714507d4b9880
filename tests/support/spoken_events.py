"""What holds of every text that a synthesiser spoke."""

from itertools import pairwise

import numpy as np
import pytest

from lipsync.phonemes import PHONEMES


def check_spoken(spoken):
    """Phonemes of the inventory that cover the sound without gaps; sound within full scale."""
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
