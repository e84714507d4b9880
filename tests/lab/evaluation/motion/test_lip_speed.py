"""How fast lips are, on motion whose speed is known."""

import numpy as np
import pytest
from lipservo_lab.evaluation.motion.measures import LipSpeed, lip_speed, lip_speed_figures

from lipsync.face.model import open_model, read_face
from lipsync.motion.finishing import lip_gap_of


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


def opened(face, gaps_mm):
    """Faces whose lips stand so far apart, mm, one a tick."""
    gap = lip_gap_of(face)
    direction = gap.per_face @ [0.0, 1.0, 0.0]
    amounts = np.linspace(-30.0, 60.0, 9001)
    faces = amounts[:, None] * direction / np.linalg.norm(direction)
    found_mm = face.lip_gaps_mm(face.markers_mm(faces))
    rising = found_mm.argmin() + np.arange(len(found_mm) - found_mm.argmin())
    at = np.interp(gaps_mm, found_mm[rising], amounts[rising])
    return at[:, None] * direction / np.linalg.norm(direction)


def test_the_fastest_point_of_the_lips_counts(face):
    speed = lip_speed(face, moved(face, [1.0, -2.0, 4.5, 0.0, -3.9]), 2.0)
    assert speed.fastest_mm_s == pytest.approx(450.0)
    assert speed.n_steps == 1
    assert lip_speed(face, moved(face, []), 0.0) == LipSpeed(0.0, 0, 0.0, 0, 0.0)


def test_the_gap_counts_apart_from_single_points(face):
    # Two lips of 300 mm/s each part at 600 mm/s: no point is fast, the gap is.
    speed = lip_speed(face, opened(face, [2.0, 5.0, 9.5, 8.0, 3.9]), 1.0)
    assert speed.widest_gap_step_mm == pytest.approx(4.5, abs=0.05)
    assert speed.n_gap_steps == 2


def test_steps_are_counted_by_the_second_of_speech():
    figures = lip_speed_figures([LipSpeed(450.0, 1, 4.5, 2, 2.0), LipSpeed(300.0, 0, 3.0, 0, 3.0)])
    assert figures == {
        "fastest_lip_mm_s": 450.0,
        "fast_steps_per_s": pytest.approx(0.2),
        "widest_gap_step_mm": 4.5,
        "gap_steps_per_s": pytest.approx(0.4),
        "spoken_s": 5.0,
    }
    assert lip_speed_figures([LipSpeed(0.0, 0, 0.0, 0, 0.0)])["fast_steps_per_s"] is None
    assert lip_speed_figures([])["gap_steps_per_s"] is None
