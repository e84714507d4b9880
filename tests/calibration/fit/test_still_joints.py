"""What moves nothing that is seen stays still."""

from dataclasses import replace

import numpy as np
import pytest
from linear_face import MODEL, SERVOS, LinearFace

from calibration.calibration import CalibrationError
from calibration.capture.capture import capture_poses
from calibration.capture.sanity import is_flat
from calibration.files.calibration_file import parse_calibration
from calibration.files.calibration_text import calibration_text
from calibration.fit.measured import fit_measured
from calibration.fit.procedure import Procedure
from calibration.simulated.robot import SimulatedRobot
from lipsync.markers import MARKERS_47

DEAD = 1


def captured(given):
    robot = SimulatedRobot(LinearFace())
    plan = Procedure(MODEL, SERVOS.joints, 20).whole_range_plan()

    def move(goal_deg):
        robot.move(given(goal_deg))
        return goal_deg

    return capture_poses(plan, MARKERS_47.names, move, robot.measure)


def test_a_dead_joint_that_is_accepted_is_never_moved():
    capture = captured(lambda goal_deg: np.where(np.arange(2) == DEAD, 0.0, goal_deg))
    with pytest.raises(CalibrationError, match=r"'corners' moves no marker.*`part: other`"):
        fit_measured(MODEL, capture, SERVOS)

    calibration = fit_measured(MODEL, capture, SERVOS, accept=True).calibration

    read = parse_calibration(calibration_text(calibration), "c.yaml")
    poses_deg = read.poses_deg(MODEL.animphos.frames)
    assert not poses_deg[:, DEAD].any()
    assert np.ptp(poses_deg[:, 0]) > 5.0
    assert (read.min_deg[DEAD], read.max_deg[DEAD]) == (-30.0, 30.0)


def test_markers_of_one_depth_are_known_for_it():
    capture = captured(lambda goal_deg: goal_deg)
    flat_mm = capture.markers_mm * [1.0, 1.0, 0.0] + [0.0, 0.0, 12.0]
    assert is_flat(replace(capture, markers_mm=flat_mm))
    assert not is_flat(capture)
