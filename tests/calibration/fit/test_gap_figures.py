"""Openings worked out by hand."""

import numpy as np
import pytest

from calibration.grade import gap_figures


def test_slope_closed_lips_and_small_openings_by_hand():
    """Two closed frames, two small openings of which one is lost, a wide one."""
    human_mm = np.array([0.0, 0.5, 2.5, 3.5, 10.0])
    wanted_mm = np.array([0.0, 0.0, 2.0, 3.0, 9.0])
    made_mm = np.array([-0.2, 0.4, 0.9, 3.0, 9.0])
    found = gap_figures(wanted_mm, made_mm, human_mm)
    assert found.small_kept == 0.5
    assert found.closed_mm == pytest.approx(0.37)  # 95 % of the way from -0.2 to 0.4
    assert found.slope == pytest.approx(np.polyfit(wanted_mm, made_mm, 1)[0])


def test_frames_count_by_their_share():
    human_mm = np.array([2.0, 3.0, 9.0])
    shares = np.array([0.3, 0.1, 0.6])
    found = gap_figures(np.array([2.0, 3.0, 9.0]), np.array([2.0, 0.0, 9.0]), human_mm, shares)
    assert found.small_kept == pytest.approx(0.75)


def test_of_what_was_not_seen_nothing_is_said():
    human_mm = np.array([8.0, 8.1, 8.2])
    found = gap_figures(human_mm, human_mm, human_mm)
    assert (found.slope, found.closed_mm, found.small_kept) == (None, None, None)
    lost = gap_figures(human_mm, np.array([np.nan, np.nan, 1.0]), human_mm)
    assert lost.slope is None
