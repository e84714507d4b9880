"""The mean of neighbouring ticks, by an expectation that knows two faces alone."""

import numpy as np
import pytest
from spoken_phonemes import spoken

from lipsync.expectation.expectation import constant_expectation
from lipsync.motion.live_synthesizer import LEAD, ExpectedMotion
from lipsync.phonemes import PHONEMES, PhonemeUpdate

SAID = spoken(("AA", 0.5), ("IY", 0.5))


def moved(lookahead_s, times_s):
    """Return faces of one component at `times_s`: 1 is expected in AA, 3 in IY from 0.5 s."""
    faces = np.zeros((len(PHONEMES), 1))
    faces[PHONEMES.index("AA")], faces[PHONEMES.index("IY")] = 1.0, 3.0
    motion = ExpectedMotion(
        constant_expectation(faces), np.ones(1), lookahead_s=lookahead_s, smoothness=0.0
    )
    motion.push(PhonemeUpdate(0.0, 1.0, 1.0, tuple(SAID)))
    return [motion.frame_at(time_s).coefficients[0] for time_s in times_s]


def test_a_border_is_crossed_in_three_ticks_about_it():
    _, *found = moved(0.1, [0.48, 0.49, 0.50, 0.51])
    assert found == pytest.approx([1.5 + 0.5 * LEAD, 2.5 + 1.5 * LEAD, 3.0 + 2.0 * LEAD])


@pytest.mark.parametrize("lookahead_s", [0.0, 0.007])
def test_what_cannot_be_known_is_not_waited_for(lookahead_s):
    _, *found = moved(lookahead_s, [0.48, 0.49, 0.50])
    assert found == pytest.approx([1.0, 3.0 + 2.0 * LEAD])
