"""A tracker that stands askew is found by the robot's own motion; a straight one is left alone."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from small_model import small_model

from calibration.calibration import CalibrationError
from calibration.capture.attitude import attitude_of, turned_like
from calibration.capture.capture import (
    Capture,
    CapturedPose,
    Robot,
    capture_poses,
    plan_poses,
)
from calibration.capture.sanity import check_capture
from calibration.capture.swaps import retake_swaps
from calibration.mouth_servos import JointRange
from calibration.simulated.face import POSITIVE_DIRECTIONS
from calibration.simulated.robot import SimulatedRobot, draw_robot
from lipsync.markers import MARKERS_47

NAMES = MARKERS_47.names
MODEL = small_model()
REST_MM = MODEL.markers_mm(MODEL.rest[None])[0]
SERVOS = tuple(POSITIVE_DIRECTIONS)
POSITIVE = tuple(POSITIVE_DIRECTIONS.values())
JOINTS = [JointRange(name, -2.0 if name == "jaw" else -30.0, 25.0) for name in SERVOS]
PLAN = plan_poses(JOINTS, 60, seed=1)
#: Of a person's lips to the hinge of the jaw: 26 degrees up (Balkwill), 90 mm back.
HINGE_MM = np.array([0.0, 90.0 * np.sin(np.deg2rad(26.0)), -90.0 * np.cos(np.deg2rad(26.0))])


ON_JAW = ("outer_lip_17", "inner_lip_14", "inner_lip_87", "inner_lip_317")


def drawn_capture(seed: int) -> Capture:
    robot = SimulatedRobot(draw_robot(REST_MM, SERVOS, seed), noise_seed=seed)
    return capture_poses(PLAN, NAMES, robot.move, robot.measure)


@pytest.fixture(scope="module")
def straight() -> Capture:
    return drawn_capture(100)


def seen_by(capture: Capture, axis: str, angle_deg: float) -> Capture:
    """The capture by a tracker that is turned about an axis, and has its zero elsewhere."""
    turn = Rotation.from_euler(axis, angle_deg, degrees=True).as_matrix()
    return replace(capture, markers_mm=capture.markers_mm @ turn.T + [30.0, -200.0, 900.0])


def jaw_capture(hinge_mm=HINGE_MM, raised=(0.0, 0.2, 0.0), sign: float = 1.0) -> Capture:
    """A rigid jaw about its hinge, seen from the lips, and an upper lip that a joint raises."""
    rng = np.random.default_rng(4)
    goals_deg = rng.uniform(-5.0, 5.0, (40, 2))
    lips_mm = REST_MM[[NAMES.index("inner_lip_13"), NAMES.index("inner_lip_14")]].mean(axis=0)
    is_on_jaw = np.array([n.startswith(("jaw", "chin")) or n in ON_JAW for n in NAMES])
    markers_mm = np.repeat(REST_MM[None], len(goals_deg), axis=0)
    from_hinge_mm = REST_MM[is_on_jaw] - lips_mm - hinge_mm
    for pose, (jaw_deg, lip_deg) in enumerate(goals_deg):
        turn = Rotation.from_euler("x", sign * jaw_deg, degrees=True)
        markers_mm[pose, is_on_jaw] = turn.apply(from_hinge_mm) + lips_mm + hinge_mm
        markers_mm[pose, [NAMES.index(f"outer_lip_{n}") for n in (39, 37, 0, 267, 269)]] += (
            sign * lip_deg * np.array(raised)
        )
    return Capture(("jaw", "upper_lip"), NAMES, goals_deg, np.ones((40, 2)), markers_mm)


JAW_POSITIVE = ("opens", "raises")


@pytest.mark.parametrize("seed", [100, 101, 102])
def test_a_straight_tracker_changes_nothing(seed):
    capture = drawn_capture(seed)
    attitude = attitude_of(capture, POSITIVE)
    assert attitude.text == ""
    assert attitude.straightened(capture) is capture


@pytest.mark.parametrize("angle_deg", [-40.0, 40.0])
@pytest.mark.parametrize("axis", "xyz")
def test_a_tracker_forty_degrees_askew_is_turned_back(straight, axis, angle_deg):
    """Its middle apart, the robot stands in the readings as a straight tracker has it."""
    askew = seen_by(straight, axis, angle_deg)
    attitude = attitude_of(askew, POSITIVE)
    left = attitude.turn * Rotation.from_euler(axis, angle_deg, degrees=True)
    pitch_deg, yaw_deg, roll_deg = np.rad2deg(left.as_rotvec())
    assert max(abs(yaw_deg), abs(roll_deg)) < 4.0
    assert abs(pitch_deg) < 10.0
    assert "stands askew" in attitude.text


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_rigid_jaw_and_a_lip_raised_straight_tell_the_pitch_to_a_degree(sign):
    """A worked example, whichever way the joints are mounted."""
    askew = seen_by(jaw_capture(sign=sign), "x", 35.0)
    attitude = attitude_of(askew, JAW_POSITIVE)
    pitch_deg = np.rad2deg(attitude.turn.as_rotvec())[0]
    assert pitch_deg == pytest.approx(-35.0, abs=1.0)
    assert attitude.is_pitched
    assert "pitch 35 (to 5)" in attitude.text


def test_a_hinge_that_no_person_has_is_outvoted_by_the_lips():
    level_mm = np.array([0.0, 0.0, -60.0])  # 26 degrees lower than expected
    assert attitude_of(jaw_capture(level_mm), JAW_POSITIVE).text == ""


def test_a_pitch_is_refused_unless_a_person_accepts_that_it_is_turned_back(straight):
    """Motion tells it no better than to five degrees, which a map of lips would show."""
    pitched = seen_by(straight, "x", 40.0)
    with pytest.raises(
        CalibrationError, match=r"pitch 4\d \(to [56]\) deg; set it level.*--accept"
    ):
        check_capture(pitched, MODEL, POSITIVE)
    checked = check_capture(pitched, MODEL, POSITIVE, accept=True)
    assert any("turned back" in warning for warning in checked.warnings)
    left = Rotation.align_vectors(
        np.diff(checked.capture.markers_mm[0], axis=0), np.diff(straight.markers_mm[0], axis=0)
    )[0]
    assert np.rad2deg(left.magnitude()) < 10.0


def test_a_dead_jaw_tells_no_pitch():
    """Its hinge is wherever noise puts it."""
    capture = jaw_capture(raised=(0.0, 0.0, 0.0))
    noise_mm = np.random.default_rng(5).normal(0.0, 0.5, capture.markers_mm.shape)
    still = replace(capture, markers_mm=REST_MM + noise_mm)
    assert attitude_of(still, JAW_POSITIVE).text == ""


def test_a_lower_lip_that_hangs_on_a_jaw_half_open_leans_with_it_and_the_tracker_does_not():
    """A worked example: the jaw stands at 10 degrees in the mean; the lip is pulled along it."""
    goals_deg = np.random.default_rng(6).uniform([0.0, -10.0], [20.0, 10.0], (60, 2))
    goals_deg[:3] = 0.0
    lower = [NAMES.index(f"outer_lip_{n}") for n in (405, 314, 17, 84, 181)]
    on_jaw = [i for i, n in enumerate(NAMES) if n.startswith(("jaw", "chin", "inner_lip_14"))]
    on_jaw += lower
    lips_mm = REST_MM[[NAMES.index("inner_lip_13"), NAMES.index("inner_lip_14")]].mean(axis=0)
    markers_mm = np.repeat(REST_MM[None], len(goals_deg), axis=0)
    for pose, (jaw_deg, lip_deg) in enumerate(goals_deg):
        markers_mm[pose, lower] += [0.0, -0.3 * lip_deg, 0.0]
        from_hinge_mm = markers_mm[pose, on_jaw] - lips_mm - HINGE_MM
        turn = Rotation.from_euler("x", jaw_deg, degrees=True)
        markers_mm[pose, on_jaw] = turn.apply(from_hinge_mm) + lips_mm + HINGE_MM
    lowered = Capture(("jaw", "lip"), NAMES, goals_deg, np.ones((60, 2)), markers_mm)
    pitch_deg = np.rad2deg(
        attitude_of(seen_by(lowered, "x", 30.0), ("opens", "lowers")).turn.as_rotvec()
    )[0]
    assert pitch_deg == pytest.approx(-30.0, abs=3.0)


def test_without_words_nothing_is_said_of_the_pitch():
    assert attitude_of(seen_by(jaw_capture(), "x", 40.0), ()).text == ""
    assert "pitch unknown" in attitude_of(seen_by(jaw_capture(), "z", 40.0), ()).text


def test_of_flat_readings_only_the_roll_is_turned_back(straight):
    flat = replace(straight, markers_mm=straight.markers_mm * [1.0, 1.0, 0.0])
    attitude = attitude_of(seen_by(flat, "z", -30.0), POSITIVE)
    assert np.rad2deg(attitude.turn.as_rotvec()) == pytest.approx([0.0, 0.0, 30.0], abs=2.0)


def test_a_roll_is_no_exchange_of_names_and_is_said(straight):
    checked = check_capture(seen_by(straight, "z", 40.0), MODEL, POSITIVE)
    (warning,) = checked.warnings
    assert "roll 40" in warning
    width_mm = checked.capture.markers_mm[0, NAMES.index("outer_lip_291")]
    width_mm = width_mm - checked.capture.markers_mm[0, NAMES.index("outer_lip_61")]
    assert abs(width_mm[1]) < 0.1 * width_mm[0]


def test_no_names_are_exchanged_in_poses_to_grade_by_that_are_seen_askew(straight):
    """A roll of 30 degrees lays dots of the lips' ring near their neighbours."""
    wanted_mm = straight.markers_mm - straight.markers_mm.mean(axis=(0, 1))
    turn = Rotation.from_euler("z", 30.0, degrees=True).as_matrix()
    taken = [CapturedPose(row, PLAN.goals_deg[row], wanted_mm[row] @ turn.T) for row in range(5)]
    robot = Robot(lambda goals_deg: goals_deg, lambda: taken[0].markers_mm)
    said: list[str] = []
    again = retake_swaps(PLAN, NAMES, robot, taken, report=said.append, expected_mm=wanted_mm)
    assert (again, said) == (taken, [])


def test_readings_are_laid_on_wanted_ones_only_where_they_are_far_from_them(straight):
    wanted_mm = straight.markers_mm[:6].copy()
    wanted_mm[2, 5] = np.nan
    askew_mm = seen_by(straight, "y", 25.0).markers_mm[:6]
    assert turned_like(askew_mm, wanted_mm) == pytest.approx(straight.markers_mm[:6], abs=1e-6)
    near_mm = seen_by(straight, "y", 5.0).markers_mm[:6]
    assert turned_like(near_mm, wanted_mm) is near_mm
