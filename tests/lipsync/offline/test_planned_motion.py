"""A planned line as a synthesiser, and the usual parts around it."""

import numpy as np
import pytest
from small_model import small_model
from spoken_phonemes import spoken

from lipsync.motion.finishing import USED_LOOKAHEAD_S, FinishedSynthesizer
from lipsync.offline.line_methods import PlannedMotion, shown_faces
from lipsync.phonemes import PhonemeUpdate

MODEL = small_model()
EVENTS = spoken(("SIL", 0.4), ("AA", 0.2), ("M", 0.12), ("AA", 0.2), ("SIL", 1.0))
TIMES_S = np.arange(180) / 100.0
#: A mouth that stands wide open whatever is said.
OPEN = np.repeat((MODEL.rest + np.array([40.0, 0, 0, 0, 0]))[None], 48, axis=0)


def gaps_mm(strength=1.0):
    motion = PlannedMotion(OPEN, 25.0, EVENTS)
    line = FinishedSynthesizer(MODEL, motion, strength, known_s=USED_LOOKAHEAD_S)
    return np.array([MODEL.lip_gap_mm(face) for face in shown_faces(line, TIMES_S)])


def test_frames_are_met_and_the_motion_between_them_is_smooth():
    faces = np.random.default_rng(0).normal(size=(10, 5))
    motion = PlannedMotion(faces, 25.0, EVENTS)

    for number, face in enumerate(faces):
        assert motion.frame_at(number / 25.0).coefficients == pytest.approx(face)
    fine = np.array([motion.frame_at(t).coefficients for t in np.arange(0.0, 0.36, 0.001)])
    assert np.abs(np.diff(fine, 2, axis=0)).max() < 0.02


def test_before_and_after_the_line_it_stands_still():
    motion = PlannedMotion(np.array([[1.0], [2.0]]), 25.0, ())

    assert motion.frame_at(-1.0).coefficients == [1.0]
    assert motion.frame_at(9.0).coefficients == [2.0]
    assert PlannedMotion(np.array([[3.0]]), 25.0, ()).frame_at(0.5).coefficients == [3.0]


def test_a_planned_line_is_not_revised():
    with pytest.raises(ValueError, match="planned"):
        PlannedMotion(OPEN, 25.0, EVENTS).push(PhonemeUpdate(0.0, 1.0, 1.0, ()))


def test_the_lips_close_for_an_m_and_the_mouth_rests_in_pauses():
    found = gaps_mm()

    assert found[60:72].min() <= 0.75
    assert found[50] > 5.0
    assert found[:10].max() < 1.0
    assert found[150:].max() < 1.0


def test_strength_brings_the_mouth_nearer_to_rest():
    assert gaps_mm(0.5)[50] < 0.7 * gaps_mm()[50]
    assert gaps_mm(0.5)[60:72].min() <= 0.75
