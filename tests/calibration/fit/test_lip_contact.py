"""Where lips stop: found from made-up poses whose stop is known, and only where they stop."""

import numpy as np
import pytest

from calibration.capture.capture import Capture
from calibration.fit.retargeting import ShapeFeatures, gap_heights_mm
from calibration.fit.robot_face import (
    LipContact,
    RobotFace,
    first_closed_mm,
    fit_contact,
    fit_robot_face,
    is_stopped,
    touching_gaps_mm,
)

GAPS = ((0, 1), (2, 3))


def test_a_gap_is_that_of_lips_that_touch_without_being_pressed_hard():
    """Of overlaps -1, 0.5, 1.5, 2.0 and 3 mm the middle three count; hidden dots are left out."""
    seen_mm = np.array([[3.0], [1.2], [1.0], [0.8], [0.1]])
    free_mm = np.array([[3.0], [1.5], [0.5], [0.0], [-1.0]])
    closed_mm = np.array([2.0])
    assert touching_gaps_mm(seen_mm, free_mm, closed_mm) == pytest.approx([1.0])
    seen_mm[2] = np.nan
    assert touching_gaps_mm(seen_mm, free_mm, closed_mm) == pytest.approx([2.0])


def test_a_gap_whose_dots_closed_lips_hide_is_taken_from_where_they_were_seen():
    seen_mm = np.array([[4.0, 3.0], [2.0, np.nan], [1.0, np.nan]])
    touches = np.array([False, True, True])
    assert first_closed_mm(seen_mm, touches) == pytest.approx([1.5, 3.0])


def test_two_poses_beyond_contact_are_no_evidence_and_three_are():
    free_mm = np.array([[4.0], [3.0], [-2.0], [-3.0], [-4.0]])
    seen_mm = np.maximum(free_mm, 0.0)
    closed_mm = np.zeros(1)
    assert is_stopped(seen_mm, free_mm, closed_mm)
    assert not is_stopped(seen_mm[:-1], free_mm[:-1], closed_mm)
    seen_mm[-1] = np.nan
    assert not is_stopped(seen_mm, free_mm, closed_mm)


def test_heights_are_upper_above_lower_and_overlap_is_what_is_missing():
    """By hand: heights 2 and -1, lips that touch at 0.5 and 0.25."""
    markers_mm = np.zeros((1, 4, 3))
    markers_mm[0, :, 1] = (5.0, 3.0, 1.0, 2.0)
    assert np.array_equal(gap_heights_mm(markers_mm, GAPS), [[2.0, -1.0]])
    contact = LipContact(np.array([0.5, 0.25]), np.zeros((2, 4, 3)))
    overlap_mm = contact.overlap_mm(gap_heights_mm(markers_mm, GAPS))
    assert np.array_equal(overlap_mm, [[0.0, 1.25]])


def test_seen_lips_stand_where_they_touch_however_far_they_would_overlap():
    """The lower lip and the chin yield to closing; nothing is changed where lips are open."""
    rng = np.random.default_rng(4)
    free_mm = np.zeros((60, 5, 3))
    heights_mm = rng.uniform(-4.0, 8.0, 60)
    free_mm[:, (1, 3), 1] = -heights_mm[:, None]
    free_mm[:, 4, 1] = -30.0 - heights_mm
    closed_mm = np.array([1.0, 1.0])
    overlap_mm = np.maximum(1.0 - heights_mm, 0.0)
    true_mm = free_mm.copy()
    true_mm[:, (1, 3, 4), 1] -= overlap_mm[:, None] * np.array([1.0, 1.0, 0.6])
    captured_mm = true_mm + rng.normal(0.0, 0.1, true_mm.shape)
    free_gaps_mm = gap_heights_mm(free_mm, GAPS)
    contact = fit_contact(captured_mm - free_mm, free_gaps_mm, closed_mm, GAPS)
    seen_mm = contact.seen_mm(free_mm, free_gaps_mm)
    wide = heights_mm > 1.0
    assert np.array_equal(seen_mm[wide], free_mm[wide])
    assert (~wide).sum() > 15
    seen_gaps_mm = gap_heights_mm(seen_mm, GAPS)
    assert seen_gaps_mm[~wide] == pytest.approx(np.ones((np.sum(~wide), 2)), abs=1e-9)
    assert np.abs(seen_mm - true_mm).max() < 0.15


def learnt(stop_mm: float) -> RobotFace:
    """From 60 poses of a jaw and an upper lip; tracker's noise 0.2 mm. -inf: nothing stops."""
    rng = np.random.default_rng(6)
    goals_deg = rng.uniform([-8.0, -10.0], [12.0, 10.0], (60, 2))
    free_mm = 2.0 + 0.9 * goals_deg[:, 0] + 0.4 * goals_deg[:, 1]
    markers_mm = np.zeros((60, 5, 3))
    markers_mm[:, :, 0] = (0.0, 0.0, 8.0, 8.0, 4.0)
    markers_mm[:, (0, 2), 1] = 0.4 * goals_deg[:, 1:]
    markers_mm[:, (1, 3), 1] = (0.4 * goals_deg[:, 1] - np.maximum(free_mm, stop_mm))[:, None]
    markers_mm[:, 4, 1] = -30.0 - 0.9 * goals_deg[:, 0]
    markers_mm += rng.normal(0.0, 0.2, markers_mm.shape)
    names = ("inner_lip_13", "inner_lip_14", "inner_lip_312", "inner_lip_317", "chin_152")
    capture = Capture(("jaw", "lip"), names, goals_deg, rng.random((60, 2)) < 0.5, markers_mm)
    return fit_robot_face(capture, ShapeFeatures((0, 1, 2, 3), GAPS))


def test_a_face_learnt_from_poses_knows_where_its_lips_stop():
    face = learnt(stop_mm=1.5)
    assert face.contact is not None
    assert face.contact.closed_mm == pytest.approx([1.5, 1.5], abs=0.2)
    pressed_deg = np.array([[-6.0, -4.0]])
    assert gap_heights_mm(face.free_mm(pressed_deg), GAPS).max() < -1.0
    assert gap_heights_mm(face.markers_mm(pressed_deg), GAPS)[0] == pytest.approx(
        [1.5, 1.5], abs=0.2
    )


def test_a_face_learnt_from_lips_that_pass_each_other_has_no_stop():
    assert learnt(stop_mm=-np.inf).contact is None
