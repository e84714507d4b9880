"""The shipped face, model and calibration belong together; every shipped YAML loads."""

import numpy as np
import pytest

from calibration.simulated_face import marker_positions_mm, simulated_face
from lipservo.assembly import assemble_face
from lipservo.settings import load_shipped_face, shipped_faces
from lipsync.markers import LOWER_INNER_LIP, UPPER_INNER_LIP
from lipsync.phonemes import PHONEMES


@pytest.mark.parametrize("name", shipped_faces())
def test_every_shipped_face_loads_with_its_calibration(name):
    face = assemble_face(name, None)
    assert len(face.joints) == len(load_shipped_face(name).servos) == 10


def test_the_closed_mouth_is_zero_degrees_and_the_robot_closes_where_the_talker_does():
    face = assemble_face("face_sim", None)
    assert not face.calibration.positions_deg(face.model.rest).any()
    rest_mm = face.model.markers_mm(face.model.rest[None])[0]
    robot = simulated_face(rest_mm, [joint.name for joint in face.joints])
    gaps_mm = []
    for phoneme in ("P", "B", "M", "AA"):
        middle = face.model.animphos[face.model.of_phoneme(phoneme), 2]
        degrees = np.array([face.calibration.positions_deg(c) for c in middle])
        markers_mm = marker_positions_mm(robot, degrees)
        gap = markers_mm[:, UPPER_INNER_LIP] - markers_mm[:, LOWER_INNER_LIP]
        gaps_mm.append(float(np.median(np.linalg.norm(gap, axis=1))))
    assert max(gaps_mm[:3]) < 2.0 < 6.0 < gaps_mm[3]


def test_the_talker_never_said_these_phonemes_and_they_have_stand_ins():
    """Stated in the model card."""
    known = assemble_face("face_sim", None).model.known_phonemes
    assert set(PHONEMES) - known == {"SH", "ZH", "NG", "ER", "OY", "UH"}
