"""The shipped face, model and calibration belong together; every shipped YAML loads."""

from collections.abc import Callable
from pathlib import Path

import lipservo.config
import numpy as np
import pytest
from lipservo_lab.learning.motion.trained_model import load_trained_model

from calibration.calibration import CalibrationError
from calibration.files.calibration_file import parse_calibration
from calibration.files.calibration_text import calibration_text
from calibration.joint_motion import joint_motion
from calibration.simulated.face import marker_positions_mm, simulated_face
from calibration.simulated.practice_robot import markers_of_face
from lipservo.calibrating.calibration_setup import CalibrationSetup
from lipservo.runtime.servos.assembly import assemble_face
from lipservo.settings.settings import load_shipped_face, shipped_faces
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array
from lipsync.markers import MARKERS_47
from lipsync.phonemes import PHONEMES

ANIMPHOS = load_trained_model().animphos
FOLDER = Path(lipservo.config.__file__).parent
N_SERVOS = {
    "face_sim": 10, "face_jaw": 1, "face_four": 4, "face_head": 16, "face_eight": 8, "face_lips": 3,
    "face_jaw_maestro": 1, "face_jaw_pca9685": 1, "face_jaw_feetech": 1, "face_head_mixed": 13,
}  # fmt: skip


def markers_of(name: str, model: FaceWithAnimPhos) -> Callable[[Array], Array]:
    """The simulated robot that a shipped face stands for."""
    servos = CalibrationSetup(load_shipped_face(name), model).servos
    return markers_of_face(model.markers_mm(model.rest[None])[0], servos)


@pytest.mark.parametrize("name", shipped_faces())
def test_every_shipped_face_loads_with_its_calibration(name):
    face = assemble_face(name, None)
    servos = load_shipped_face(name).servos
    assert len(face.joints) == len(servos) == N_SERVOS[name]
    assert face.calibration.servo_names == tuple(load_shipped_face(name).mouth_servos)


@pytest.mark.parametrize(
    "file", sorted(FOLDER.glob("*.calibration.yaml")), ids=lambda file: file.name.split(".")[0]
)
def test_every_shipped_calibration_carries_a_checksum_that_holds(file):
    """One digit of the file is changed: it is refused."""
    text = file.read_text(encoding="utf-8")
    assert "\nchecksum: " in text
    whole = parse_calibration(text, file.name)
    assert calibration_text(whole) == text
    digit = text.index("max_deg: ") + len("max_deg: ")
    changed = text[:digit] + ("1" if text[digit] != "1" else "2") + text[digit + 1 :]
    with pytest.raises(CalibrationError, match="its checksum differs"):
        parse_calibration(changed, file.name)


@pytest.mark.parametrize("name", ["face_eight", "face_lips"])
def test_faces_of_other_shapes_carry_a_measured_grade_and_lags(name):
    calibration = assemble_face(name, None).calibration
    assert calibration.grade is not None
    assert calibration.grade.n_poses == 10
    assert calibration.following is not None
    assert (calibration.following.lag_s > 0.0).all()


@pytest.mark.parametrize("name", shipped_faces())
def test_speech_moves_every_shipped_face_rightly(name):
    """Open vowels open, closures close, round vowels narrow."""
    face = assemble_face(name, None)
    mouth = load_shipped_face(name).mouth_servos
    motions = {n: joint_motion(n, servo.positive) for n, servo in mouth.items()}

    def middle_deg(phoneme: str) -> dict[str, float]:
        """Of each joint that says what it moves, forward as its channel has it."""
        frames = ANIMPHOS.samples[ANIMPHOS.of_phoneme(phoneme), 2]
        degrees = np.median([face.calibration.positions_deg(f) for f in frames], axis=0)
        named = zip(face.calibration.servo_names, degrees, strict=True)
        return {n: motions[n].sign * deg for n, deg in named if motions[n] is not None}

    ah, oo, ee, m = (middle_deg(phoneme) for phoneme in ("AA", "UW", "IY", "M"))
    (jaw,) = (n for n, motion in motions.items() if motion.channel == "jaw")
    assert ah[jaw] > 4.0 > 2.5 > abs(m[jaw])
    assert ah[jaw] > 1.2 * max(oo[jaw], ee[jaw])
    corners = [n for n, motion in motions.items() if motion.channel == "corner_out"]
    assert len(corners) in (0, 2)
    for corner in corners:
        assert oo[corner] < ee[corner]


@pytest.mark.parametrize("name", shipped_faces())
def test_the_lips_of_every_shipped_face_open_as_the_speakers_do(name):
    face = assemble_face(name, None)
    frames = ANIMPHOS.samples[::20].reshape(-1, face.model.n_components)
    human_mm = [face.model.lip_gap_mm(frame) for frame in frames]
    degrees = np.array([face.calibration.positions_deg(frame) for frame in frames])
    markers_mm = markers_of(name, face.model)(degrees)
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
