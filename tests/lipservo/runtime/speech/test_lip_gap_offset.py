"""Lips more open or closed than planned, while the face runs."""

import numpy as np
import pytest
from small_model import small_model
from speaking_side import SpeakingSide

from lipservo.runtime.speech.speech import LipGapOffset
from lipsync.face.model import load_face

PERIOD_S = 0.01


@pytest.fixture(scope="module")
def model():
    return load_face()


def fed(offset, face, seconds):
    return np.array([offset.feed(face) for _ in range(round(seconds / PERIOD_S))])


def gaps_mm(model, faces):
    return model.layout.gap_vectors_mm(model.markers_mm(faces))[:, 1]


@pytest.mark.parametrize("offset_mm", [-1.5, 0.5, 3.0])
def test_the_gap_is_as_much_wider_as_was_set(model, offset_mm):
    offset = LipGapOffset(model, 0.0, PERIOD_S)
    offset.change({"lip_gap_offset_mm": offset_mm, "strength": 0.3})
    shown = gaps_mm(model, fed(offset, model.rest, 2.0))
    assert shown[-1] - gaps_mm(model, model.rest[None])[0] == pytest.approx(offset_mm, abs=0.01)


def test_a_change_is_eased_in_and_nothing_is_overshot(model):
    offset = LipGapOffset(model, 0.0, PERIOD_S)
    before = offset.feed(model.rest)
    offset.change({"lip_gap_offset_mm": 3.0})
    shown = gaps_mm(model, np.array([before, *fed(offset, model.rest, 2.0)]))
    steps_mm = np.diff(shown)
    assert steps_mm.min() >= -1e-6
    assert steps_mm.max() < 0.25  # 25 mm/s: what lips do in speech
    assert steps_mm[0] < 0.5 * steps_mm.max()
    reached_s = PERIOD_S * np.argmax(shown > shown[0] + 2.85)
    assert 0.1 < reached_s < 0.4


def test_without_an_offset_a_face_is_left_as_it_is(model):
    face = np.arange(model.n_components, dtype=float)
    offset = LipGapOffset(model, 0.0, PERIOD_S)
    offset.change({"strength": 1.2})
    assert offset.feed(face) is face
    offset.change({"lip_gap_offset_mm": 1.0})
    fed(offset, face, 2.0)
    offset.change({"lip_gap_offset_mm": 0.0})
    assert fed(offset, face, 2.0)[-1].tolist() == face.tolist()


def test_any_model_has_one():
    small = small_model()
    offset = LipGapOffset(small, 2.0, PERIOD_S)
    assert np.isfinite(offset.feed(small.rest)).all()
    assert not np.array_equal(offset.feed(small.rest), small.rest)


def test_the_robot_opens_by_it_and_a_mouth_that_is_cut_off_keeps_it():
    robot = SpeakingSide()
    side = robot.side

    def act(now_s):
        if now_s == pytest.approx(1.0):
            side.change({"lip_gap_offset_mm": 2.0})
        if now_s == pytest.approx(3.0):
            side.speech.cut_off(100.0 + now_s, robot.face.model.rest)

    watched = robot.run(4.0, act)
    gaps = watched.gap_mm
    assert gaps[250] - gaps[90] > 0.5
    assert gaps[390] == pytest.approx(gaps[290], abs=0.2)
