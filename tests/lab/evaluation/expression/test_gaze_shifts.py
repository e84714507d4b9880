"""Saccades and blinks found in tracks where they are known."""

import numpy as np
import pytest
from gaze_shifts import gaze_shifts
from lipservo_lab.evaluation.expression.expression_figures import (
    blink_cues,
    blinks_per_min,
)

from lipsync.expression.gaze import Saccade


def test_saccades_are_found_with_their_sizes():
    gaze, at = [(0.0, 0.0)] * 10, (0.0, 0.0)
    for aim in [(3.0, 4.0), (-9.0, 4.0), (0.0, -12.0)]:
        saccade = Saccade(at, aim)
        while not saccade.is_over:
            gaze.append(saccade.step())
        gaze += [aim] * 20
        at = aim
    found = gaze_shifts(np.array(gaze))
    assert found.magnitude_deg == pytest.approx([5.0, 12.0, np.hypot(9.0, 16.0)])
    assert found.duration_s == pytest.approx(0.025 + 0.0024 * found.magnitude_deg, abs=0.01)
    assert found.start_s[0] == pytest.approx(0.09)


def test_blinks_are_counted_where_they_count():
    lid = np.zeros(6000)
    for first in (100, 1000, 4000):
        lid[first : first + 10] = 1.0
    lid[2000:3000] = 0.5  # looking down is no blink
    assert blink_cues(lid).tolist() == [100, 1000, 4000]
    counts = np.arange(6000) < 3000
    assert blinks_per_min(lid, counts) == pytest.approx(4.0)
    assert np.isnan(blinks_per_min(lid, np.zeros(6000, bool)))
