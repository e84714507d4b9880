import numpy as np
import pytest
from small_model import small_model

from calibration.simulated.face import (
    HORN_ARM_MM,
    JAW_AXIS_ABOVE_LIPS_MM,
    JAW_AXIS_BEHIND_LIPS_MM,
    POSITIVE_DIRECTIONS,
    SimulatedFace,
    marker_positions_mm,
    simulated_face,
)
from lipsync.markers import MARKERS_47

MIRROR_LANDMARKS = (
    *((61, 291), (39, 269), (37, 267), (181, 405), (84, 314), (78, 308), (82, 312), (87, 317)),
    *((98, 327), (172, 397), (136, 365), (149, 378), (176, 400)),
    *((50, 280), (205, 425), (207, 427), (187, 411), (216, 436), (212, 432)),
)


@pytest.fixture(scope="module")
def face() -> SimulatedFace:
    model = small_model()
    return simulated_face(model.markers_mm(model.rest[None])[0], tuple(POSITIVE_DIRECTIONS))


def motion_mm(face: SimulatedFace, **positions_deg: float) -> np.ndarray:
    """(47, 3): how far the markers are from neutral with some servos turned."""
    pose = np.array([[positions_deg.get(name, 0.0) for name in face.servo_names]])
    return marker_positions_mm(face, pose)[0] - face.neutral_mm


def row(landmark: int) -> int:
    return MARKERS_47.landmarks.index(landmark)


def test_all_servos_at_zero_give_the_neutral_face(face):
    assert np.array_equal(motion_mm(face), np.zeros((47, 3)))


def test_jaw_turns_the_chin_about_the_hinge_by_hand(face):
    """Chin (0, -140, -5), lips at (0, -96, 12): the chin is 83 below and 73 before the hinge."""
    assert (JAW_AXIS_ABOVE_LIPS_MM, JAW_AXIS_BEHIND_LIPS_MM) == (39.0, 90.0)
    # 30 degrees: y = -83 cos - 73 sin = -108.38, z = -83 sin + 73 cos = 21.72; moved by these:
    expected_mm = (0.0, -108.3801 + 83.0, 21.7199 - 73.0)
    assert motion_mm(face, jaw=30.0)[row(152)] == pytest.approx(expected_mm, abs=1e-3)


def test_lip_corners_follow_half_of_the_jaw_and_the_upper_lip_none(face):
    full, moved = motion_mm(face, jaw=10.0)[row(14)], motion_mm(face, jaw=10.0)
    assert moved[MARKERS_47.upper_lip] == pytest.approx((0, 0, 0))
    assert moved[MARKERS_47.lower_lip, 1] < -10.0
    assert 0.4 < moved[row(61), 1] / full[1] < 0.6
    assert np.abs(moved[row(2)]).max() < 1e-3  # under the nose


def test_the_jaw_line_follows_less_towards_the_ear(face):
    share = [face.jaw_share[row(n)] for n in (152, 400, 378, 365, 397)]
    assert share == sorted(share, reverse=True)


@pytest.mark.parametrize(
    ("servo", "landmark", "direction"),
    [
        ("upper_lip_left", 269, (0, 1, 0)),
        ("upper_lip_right", 39, (0, 1, 0)),
        ("lower_lip_left", 405, (0, -1, 0)),
        ("lower_lip_right", 181, (0, -1, 0)),
        ("corner_left_out", 291, (0.866, 0, -0.5)),
        ("corner_right_out", 61, (-0.866, 0, -0.5)),
        ("corner_left_up", 291, (0, 1, 0)),
        ("corner_right_up", 61, (0, 1, 0)),
    ],
)
def test_the_skin_at_a_horn_moves_by_arm_times_sine(face, servo, landmark, direction):
    travel_mm = HORN_ARM_MM * 0.5  # sin 30 degrees
    weight = 0.5 if landmark in (61, 291) and "lip" in servo else 1.0
    moved = motion_mm(face, **{servo: 30.0})
    expected_mm = weight * travel_mm * np.array(direction)
    assert moved[row(landmark)] == pytest.approx(expected_mm, abs=1e-9)
    assert np.linalg.norm(moved, axis=1).argmax() == row(landmark)


def test_a_horn_pulls_the_less_the_farther_away(face):
    moved = motion_mm(face, corner_left_out=20.0)
    distance_mm = np.linalg.norm(face.neutral_mm - face.neutral_mm[row(291)], axis=1)
    pulled_mm = np.linalg.norm(moved, axis=1)[np.argsort(distance_mm)]
    assert (np.diff(pulled_mm) <= 1e-12).all()


def test_left_servos_move_the_left_side_which_has_positive_x(face):
    left = face.neutral_mm[:, 0] > 0
    for servo in ("upper_lip_left", "lower_lip_left", "corner_left_out", "corner_left_up"):
        moved_mm = np.linalg.norm(motion_mm(face, **{servo: 20.0}), axis=1)
        assert moved_mm[left].sum() > 3 * moved_mm[face.neutral_mm[:, 0] < 0].sum(), servo


def test_upper_lip_servos_leave_the_lower_lip_alone_and_open_the_mouth(face):
    upper = motion_mm(face, upper_lip_left=20.0, upper_lip_right=20.0)
    lower = motion_mm(face, lower_lip_left=20.0, lower_lip_right=20.0)
    assert np.abs(upper[MARKERS_47.lower_lip]).max() == 0.0
    assert np.abs(lower[MARKERS_47.upper_lip]).max() == 0.0
    assert upper[MARKERS_47.upper_lip, 1] > 1.0 > -1.0 > lower[MARKERS_47.lower_lip, 1]


def test_protrusion_brings_all_lips_forward_and_the_corners_together(face):
    moved = motion_mm(face, lip_protrusion=30.0)
    assert moved[list(MARKERS_47.lips), 2] == pytest.approx(HORN_ARM_MM * 0.5)
    assert moved[row(61), 0] == pytest.approx(-moved[row(291), 0])
    assert moved[row(61), 0] > 1.0


def test_the_face_is_as_symmetric_as_its_neutral(face):
    rng = np.random.default_rng(1)
    pose = dict(zip(face.servo_names, rng.uniform(-20, 20, 10), strict=True))
    swapped = {
        name.replace("left", "#").replace("right", "left").replace("#", "right"): angle
        for name, angle in pose.items()
    }
    order = np.arange(47)
    for right, left in MIRROR_LANDMARKS:
        order[[row(right), row(left)]] = row(left), row(right)
    mirrored = motion_mm(face, **swapped)[order] * (-1, 1, 1)
    assert np.allclose(motion_mm(face, **pose), mirrored, atol=1e-12)


def test_a_face_may_have_some_of_the_servos_in_any_order(face):
    names = ("corner_left_up", "jaw")
    few = simulated_face(face.neutral_mm, names)
    assert np.array_equal(
        motion_mm(few, jaw=5.0, corner_left_up=9.0), motion_mm(face, jaw=5.0, corner_left_up=9.0)
    )
    lips_only = simulated_face(face.neutral_mm, names[:1])
    assert motion_mm(lips_only, corner_left_up=9.0)[row(291), 1] > 1.0


def test_many_poses_at_once_are_the_poses_one_by_one(face):
    poses = np.random.default_rng(2).uniform(-20, 20, (4, 10))
    one_by_one = [marker_positions_mm(face, pose[None])[0] for pose in poses]
    assert np.allclose(marker_positions_mm(face, poses), one_by_one)


def test_a_servo_without_a_place_is_refused_with_the_known_ones(face):
    with pytest.raises(ValueError, match=r"servo 'tail' is not in .* knows jaw, upper_lip_left"):
        simulated_face(face.neutral_mm, ["jaw", "tail"])


def test_a_neutral_of_another_shape_is_refused(face):
    with pytest.raises(ValueError, match=r"shape \(47, 3\), not \(39, 3\)"):
        simulated_face(face.neutral_mm[:39], ["jaw"])
