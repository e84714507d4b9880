"""The guided way: landmark poses, and the map through what a person made of them."""

import numpy as np
import pytest
from small_model import small_model

from calibration.calibration import CalibrationError
from calibration.files.calibration_file import parse_calibration
from calibration.files.calibration_text import calibration_text
from calibration.fit.guided import CLOSED, fit_guided, landmark_poses
from calibration.mouth_servos import JointRange, MouthServos
from calibration.simulated.face import POSITIVE_DIRECTIONS
from lipsync.markers import MARKERS_47

SERVOS = tuple(POSITIVE_DIRECTIONS)
JOINTS = tuple(JointRange(name, -2.0 if name == "jaw" else -35.0, 35.0) for name in SERVOS)
MOUTH = MouthServos(JOINTS, "f" * 16)
LIMITS = MOUTH.limits_deg
MODEL = small_model()


def test_guided_poses_of_a_linear_robot_are_found_again():
    """Without misjudgement and with angles linear in the coefficients the map is exact."""
    law = np.random.default_rng(6).normal(size=(10, 5)) / 3
    poses = landmark_poses(MODEL)
    made = {pose.name: 1.0 + law @ (pose.coefficients - MODEL.rest) for pose in poses}
    guided = fit_guided(MODEL, MOUTH, made)
    for frame in MODEL.animphos.samples[:20, 2]:
        expected = np.clip(1.0 + law @ (frame - MODEL.rest), *LIMITS)
        assert guided.positions_deg(frame) == pytest.approx(expected, abs=0.3)
    assert guided.positions_deg(MODEL.rest) == pytest.approx(np.ones(10))
    assert guided.errors.n_frames == 0
    assert parse_calibration(calibration_text(guided), "g").origin.method == "guided"


def test_guided_poses_without_the_closed_mouth_or_too_few_are_refused():
    poses = landmark_poses(MODEL)
    made = {pose.name: np.zeros(10) for pose in poses}
    with pytest.raises(CalibrationError, match="the pose 'closed' is missing"):
        fit_guided(MODEL, MOUTH, {k: v for k, v in made.items() if k != CLOSED})
    few = {pose.name: np.zeros(10) for pose in poses[:5]}
    with pytest.raises(CalibrationError, match="5 poses are too few; 7 are needed"):
        fit_guided(MODEL, MOUTH, few)


def test_landmark_poses_look_like_their_names():
    shape_mm = {
        pose.name: MODEL.markers_mm(pose.coefficients[None])[0] for pose in landmark_poses(MODEL)
    }

    def opening(name):
        return shape_mm[name][MARKERS_47.upper_lip, 1] - shape_mm[name][MARKERS_47.lower_lip, 1]

    def width(name):
        return np.ptp(shape_mm[name][list(MARKERS_47.lips), 0])

    assert opening("closed") < 0.5 < 5.0 < opening("open")
    assert width("narrow") < width("closed") < width("wide")
