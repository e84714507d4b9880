"""Motion at another rate is the same motion at other times."""

from pathlib import Path

import numpy as np
import pytest
from lipservo_lab.corpus.utterance import Utterance, at_frame_rate


def waving(rate_hz, frequency_hz, duration_s=3.0):
    times_s = np.arange(0.0, duration_s, 1.0 / rate_hz)
    wave = 10.0 + 4.0 * np.sin(2.0 * np.pi * frequency_hz * times_s)
    markers_mm = np.tile(wave[:, None, None], (1, 2, 3)).astype(np.float32)
    return Utterance("u", markers_mm, rate_hz, Path("u.flac"), (), ())


@pytest.mark.parametrize("rate_hz", [24.0, 25.0, 30000 / 1001, 30.0, 50.0, 60.0])
def test_slow_motion_is_kept(rate_hz):
    """Away from the ends to 0.1 mm of 4; 3 Hz is as fast as jaws go."""
    made = at_frame_rate(waving(rate_hz, 3.0), 25.0)
    expected = waving(25.0, 3.0)
    assert made.frame_rate_hz == 25.0
    assert abs(len(made.markers_mm) - len(expected.markers_mm)) <= 1
    np.testing.assert_allclose(made.markers_mm[10:60], expected.markers_mm[10:60], atol=0.1)


def test_what_fewer_frames_cannot_show_is_not_shown_as_something_else():
    """20 Hz at 60 frames a second would be 5 Hz at 25."""
    made = at_frame_rate(waving(60.0, 20.0), 25.0).markers_mm[10:60]
    assert np.ptp(made) < 0.4


def test_the_same_rate_changes_nothing():
    sentence = waving(25.0, 3.0)
    np.testing.assert_array_equal(at_frame_rate(sentence, 25.0).markers_mm, sentence.markers_mm)
