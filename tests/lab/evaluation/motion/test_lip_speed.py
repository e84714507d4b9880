"""How fast lips are, on motion whose speed is known."""

import numpy as np
import pytest
from lipservo_lab.evaluation.motion.measures import LipSpeed, lip_speed, lip_speed_figures

from lipsync.face.model import open_model, read_face


@pytest.fixture(scope="module")
def face():
    with open_model() as file:
        return read_face(file)


def moved(face, steps_mm):
    """Faces whose fastest point of the lips goes these distances, mm, one a tick."""
    direction = np.eye(face.n_components)[0]
    shift = face.basis[0].reshape(-1, 3)[list(face.layout.lips)]
    per_unit_mm = np.linalg.norm(shift, axis=1).max()
    return np.cumsum(np.concatenate([[0.0], steps_mm]))[:, None] / per_unit_mm * direction


def test_the_fastest_point_of_the_lips_counts(face):
    speed = lip_speed(face, moved(face, [1.0, -2.0, 4.5, 0.0, -3.9]), 2.0)
    assert speed.fastest_mm_s == pytest.approx(450.0)
    assert speed.n_steps == 1
    assert lip_speed(face, moved(face, []), 0.0) == LipSpeed(0.0, 0, 0.0)


def test_steps_are_counted_by_the_second_of_speech():
    figures = lip_speed_figures([LipSpeed(450.0, 1, 2.0), LipSpeed(300.0, 0, 3.0)])
    assert figures == {"fastest_lip_mm_s": 450.0, "fast_steps_per_s": pytest.approx(0.2)}
    assert lip_speed_figures([LipSpeed(0.0, 0, 0.0)])["fast_steps_per_s"] is None
    assert lip_speed_figures([]) == {"fastest_lip_mm_s": 0.0, "fast_steps_per_s": None}
