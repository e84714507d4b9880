"""Corners of the mouth on the shipped face: rounded on a stage, apart for a smile, else as ever."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lipservo_lab.evaluation.motion.measures import lip_shapes_mm
from lipservo_lab.learning.motion.trained_model import load_trained_model
from spoken_phonemes import spoken

from lipsync.expectation.expectation import track_of
from lipsync.markers import PointLayout
from lipsync.motion.finishing import Style
from lipsync.motion.live_synthesizer import LiveSynthesizer
from lipsync.motion.rounding import ROUNDED, ROUNDED_SHARE, is_due, lip_width_of
from lipsync.motion.tick_plan import TICK_S
from lipsync.phonemes import PhonemeUpdate

MODEL = load_trained_model()
WIDTH = lip_width_of(MODEL)
COVERAGE = np.sqrt(np.diag(MODEL.covariance))


def vowel_mm(vowel: str, stage: float, *around: str) -> np.ndarray:
    """Return (3,): lip gap, width and protrusion in mm in the middle of a vowel of 0.2 s.

    around: phonemes of 0.08 s each that are spoken before the vowel. stage: as in `Style`.
    """
    before = tuple((phoneme, 0.08) for phoneme in around)
    events = spoken(("SIL", 0.4), *before, (vowel, 0.2), ("T", 0.08), ("SIL", 0.4))
    synthesizer = LiveSynthesizer(MODEL, MODEL.expectation, Style(stage=stage))
    synthesizer.push(PhonemeUpdate(0.0, math.inf, math.inf, events))
    middle_s = 0.4 + 0.08 * len(around) + 0.1
    faces = [synthesizer.frame_at(n * TICK_S).coefficients for n in range(round(middle_s / TICK_S))]
    return lip_shapes_mm(MODEL, MODEL.markers_mm(faces[-1][None]))[0]


@pytest.mark.parametrize("around", [(), ("T",), ("S",), ("B",)])
def test_on_a_stage_ow_and_uw_look_unlike_aa_and_iy(around):
    shapes = {v: vowel_mm(v, 1.0, *around) for v in ("AA", "IY", "OW", "UW")}
    assert shapes["OW"][0] <= 0.75 * shapes["AA"][0]
    for vowel in ("OW", "UW"):
        assert shapes[vowel][1] <= 0.8 * shapes["IY"][1]
        assert shapes[vowel][2] > shapes["AA"][2] + 1.0, "it puckers"


def test_on_a_stage_the_mouth_opens_farther():
    assert vowel_mm("AA", 1.0)[0] > 1.2 * vowel_mm("AA", 0.0)[0]


@given(st.lists(st.floats(-3.0, 3.0), min_size=8, max_size=8), st.floats(0.0, 1.0))
def test_corners_come_together_and_the_lip_gap_stays(deviations, amount):
    face = MODEL.rest + np.array(deviations) * COVERAGE
    rounded = WIDTH.rounded(face, amount)
    gap_mm, rounded_mm = (MODEL.lip_gaps_mm(MODEL.markers_mm(f[None]))[0] for f in (face, rounded))
    assert rounded_mm == pytest.approx(gap_mm, abs=0.05)
    before, after = (WIDTH.at_mean_mm + f @ WIDTH.per_face for f in (face, rounded))
    assert after <= before + 1e-9
    if amount == 1.0:
        assert after <= ROUNDED_SHARE * WIDTH.at_rest_mm + 1e-6


def test_a_smile_draws_the_corners_apart_and_up_and_sadness_the_other_way():
    def corners(face: np.ndarray) -> np.ndarray:
        points = [MODEL.layout.landmarks.index(n) for n in (291, 61)]
        return MODEL.markers_mm(face[None])[0, points]

    neutral, glad, sad = (corners(WIDTH.smiling(MODEL.rest, v)) for v in (0.0, 1.0, -1.0))
    assert np.ptp(glad[:, 0]) > np.ptp(neutral[:, 0]) + 3.0 > np.ptp(sad[:, 0]) + 6.0
    assert glad[:, 1].mean() > neutral[:, 1].mean() > sad[:, 1].mean()


def test_lips_begin_to_round_before_the_sound_as_far_as_it_is_known():
    track = track_of(spoken(("SIL", 0.4), ("T", 0.1), ("UW", 0.2), ("T", 0.1)))
    assert not is_due(ROUNDED, track, 0.39, 0.6)
    assert is_due(ROUNDED, track, 0.41, 0.6)
    assert not is_due(ROUNDED, track, 0.41, 0.45), "not known yet"
    assert not is_due(ROUNDED, track, 0.66, 0.75), "spreads before the vowel ends"


def test_a_face_without_points_of_the_lips_has_no_corners():
    layout = MODEL.layout
    chin = PointLayout("chin", (("chin", layout.landmarks),), layout.gap_landmarks)
    assert lip_width_of(replace(MODEL, layout=chin)) is None
