"""The textbook's way is a fair rival: what it can solve it solves."""

import numpy as np
import pytest
from linear_face import SERVOS, LinearFace
from lipservo_lab.bench.calibration.shown_motion import NAMES, rival_poses_deg

from calibration.capture.capture import Capture
from lipsync.markers import MARKERS_47

FACE = LinearFace()
LOW_DEG, HIGH_DEG = SERVOS.limits_deg
WANTED_DEG = np.random.default_rng(1).uniform(LOW_DEG, HIGH_DEG, (20, 2))


def capture_of(markers_of) -> Capture:
    goals_deg = np.random.default_rng(0).uniform(LOW_DEG, HIGH_DEG, (60, 2))
    seen_mm = markers_of(goals_deg)
    return Capture(SERVOS.names, MARKERS_47.names, goals_deg, np.ones((60, 2)), seen_mm)


def curved_mm(angles_deg):
    return FACE.markers_mm(angles_deg + 0.02 * angles_deg**2)


@pytest.mark.parametrize("degree", [1, 2])
def test_a_linear_robot_is_solved(degree):
    """But for the two thousandths that the pull to neutral takes."""
    features = NAMES.shape_features.of(FACE.markers_mm(WANTED_DEG))
    found_deg = rival_poses_deg(capture_of(FACE.markers_mm), SERVOS, features, degree)
    assert found_deg == pytest.approx(WANTED_DEG, rel=2e-3, abs=0.01)


def test_a_curved_robot_needs_the_second_degree():
    features = NAMES.shape_features.of(curved_mm(WANTED_DEG))
    straight, curved = (
        np.abs(rival_poses_deg(capture_of(curved_mm), SERVOS, features, degree) - WANTED_DEG)
        for degree in (1, 2)
    )
    assert np.median(curved) < 0.1
    assert np.median(straight) > 0.5


def test_what_is_out_of_reach_is_met_at_the_limit():
    features = NAMES.shape_features.of(FACE.markers_mm(np.array([[90.0, -90.0]])))
    found_deg = rival_poses_deg(capture_of(FACE.markers_mm), SERVOS, features, 1)
    assert found_deg == pytest.approx(np.array([[HIGH_DEG[0], LOW_DEG[1]]]))


def test_lost_points_are_taken_for_the_usual_ones():
    capture = capture_of(FACE.markers_mm)
    capture.markers_mm[np.random.default_rng(2).random((60, 47)) < 0.02] = np.nan
    features = NAMES.shape_features.of(FACE.markers_mm(WANTED_DEG))
    found_deg = rival_poses_deg(capture, SERVOS, features, 1)
    assert found_deg == pytest.approx(WANTED_DEG, abs=1.5)
