"""The shipped face, model and calibration belong together; every shipped YAML loads."""

import numpy as np
import pytest

from calibration.simulated.face import marker_positions_mm, simulated_face
from lipservo.face.assembly import assemble_face
from lipservo.settings.settings import load_shipped_face, shipped_faces
from lipsync.markers import MARKERS_47
from lipsync.phonemes import PHONEMES
from lipsync.training.trained_model import load_trained_model

ANIMPHOS = load_trained_model().animphos


@pytest.mark.parametrize("name", shipped_faces())
def test_every_shipped_face_loads_with_its_calibration(name):
    face = assemble_face(name, None)
    servos = load_shipped_face(name).servos
    n_servos = {"face_sim": 10, "face_jaw": 1, "face_four": 4, "face_head": 16}
    assert len(face.joints) == len(servos) == n_servos[name]
    assert face.calibration.servo_names == tuple(load_shipped_face(name).mouth_servos)


@pytest.mark.parametrize("name", shipped_faces())
def test_speech_moves_every_shipped_face_rightly(name):
    """Open vowels open, closures close, round vowels narrow."""
    face = assemble_face(name, None)
    mouth = list(load_shipped_face(name).mouth_servos)

    def middle_deg(phoneme: str) -> dict[str, float]:
        frames = ANIMPHOS.samples[ANIMPHOS.of_phoneme(phoneme), 2]
        degrees = np.median([face.calibration.positions_deg(f) for f in frames], axis=0)
        return dict(zip(face.calibration.servo_names, degrees, strict=True))

    ah, oo, ee, m = (middle_deg(phoneme) for phoneme in ("AA", "UW", "IY", "M"))
    assert ah["jaw"] > 4.0 > 1.5 > abs(m["jaw"])
    assert ah["jaw"] > 1.2 * max(oo["jaw"], ee["jaw"])
    if "corner_left_out" in mouth:
        for corner in ("corner_left_out", "corner_right_out"):
            assert oo[corner] < ee[corner]


@pytest.mark.parametrize("name", shipped_faces())
def test_the_lips_of_every_shipped_face_open_as_the_speakers_do(name):
    face = assemble_face(name, None)
    mouth = list(load_shipped_face(name).mouth_servos)
    frames = ANIMPHOS.samples[::20].reshape(-1, face.model.n_components)
    human_mm = [face.model.lip_gap_mm(frame) for frame in frames]
    robot = simulated_face(face.model.markers_mm(face.model.rest[None])[0], mouth)
    degrees = np.array([face.calibration.positions_deg(frame) for frame in frames])
    markers_mm = marker_positions_mm(robot, degrees)
    gaps = markers_mm[:, MARKERS_47.upper_lip] - markers_mm[:, MARKERS_47.lower_lip]
    assert np.corrcoef(human_mm, np.linalg.norm(gaps, axis=1))[0, 1] > 0.95


def test_the_closed_mouth_is_zero_degrees_and_the_robot_closes_where_the_speaker_does():
    face = assemble_face("face_sim", None)
    assert not face.calibration.positions_deg(face.model.rest).any()
    rest_mm = face.model.markers_mm(face.model.rest[None])[0]
    robot = simulated_face(rest_mm, [joint.name for joint in face.joints])
    gaps_mm = []
    for phoneme in ("P", "B", "M", "AA"):
        middle = ANIMPHOS.samples[ANIMPHOS.of_phoneme(phoneme), 2]
        degrees = np.array([face.calibration.positions_deg(c) for c in middle])
        markers_mm = marker_positions_mm(robot, degrees)
        gap = markers_mm[:, MARKERS_47.upper_lip] - markers_mm[:, MARKERS_47.lower_lip]
        gaps_mm.append(float(np.median(np.linalg.norm(gap, axis=1))))
    assert max(gaps_mm[:3]) < 2.0 < 6.0 < gaps_mm[3]


def test_the_speaker_never_said_these_phonemes_and_they_have_stand_ins():
    """Stated in the model card."""
    known = ANIMPHOS.known_phonemes
    assert set(PHONEMES) - known == {"SH", "ZH", "NG", "ER", "OY", "UH"}
