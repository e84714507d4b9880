"""There is a robot to practise on for every face, whatever its joints are called."""

import numpy as np
import pytest
from small_model import small_model

from calibration.calibration import CalibrationError
from calibration.mouth_servos import JointRange, MouthServos
from calibration.simulated.practice_robot import (
    family_of,
    guessed_joints,
    markers_of_face,
    practice_robot,
)
from calibration.simulated.robot import SimulatedRobot
from calibration.simulated.robot_family import RobotFamily

MODEL = small_model()
REST_MM = MODEL.markers_mm(MODEL.rest[None])[0]


def servos(*named):
    joints = tuple(JointRange(name, -10.0, 10.0) for name, _ in named)
    return MouthServos(joints, "face", (), tuple(word for _, word in named))


OWN = servos(("jaw", "opens"), ("lip_protrusion", "protrudes"))
FOREIGN = servos(("kiefer", "opens"), ("m2", "raises"), ("drei", "turns"))


def test_the_simulated_face_where_it_knows_the_names_else_an_elastic_robot():
    assert family_of(OWN) is RobotFamily.OWN
    assert isinstance(practice_robot(REST_MM, OWN, 3), SimulatedRobot)
    assert isinstance(practice_robot(REST_MM, OWN, 3, RobotFamily.ELASTIC), SimulatedRobot)
    assert isinstance(practice_robot(REST_MM, FOREIGN, 3), SimulatedRobot)


@pytest.mark.parametrize("of", [OWN, FOREIGN, servos(("x", ""))])
def test_every_joint_moves_something(of):
    markers_of = markers_of_face(REST_MM, of)
    n = len(of.joints)
    rest_mm = markers_of(np.zeros((1, n)))
    assert rest_mm.shape == (1, 47, 3)
    moved_mm = np.linalg.norm(markers_of(8.0 * np.eye(n)) - rest_mm, axis=2)
    assert (moved_mm.max(axis=1) > 0.3).all()


def test_a_joint_of_which_nobody_says_what_it_moves_is_named():
    assert list(guessed_joints(FOREIGN)) == ["m2", "drei"]
    assert list(guessed_joints(OWN)) == []


def test_what_cannot_be_is_refused_in_a_line():
    with pytest.raises(CalibrationError, match=r"servo 'kiefer' is not in .* --family elastic"):
        practice_robot(REST_MM, FOREIGN, 3, RobotFamily.OWN)
    for make in (
        lambda: practice_robot(REST_MM, servos(), 0),
        lambda: markers_of_face(REST_MM, servos()),
    ):
        with pytest.raises(CalibrationError, match="no servo of `part: mouth`"):
            make()
