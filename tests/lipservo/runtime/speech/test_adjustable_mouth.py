"""An excited voice moves the mouth more; lips that close stay closed."""

import math

import numpy as np
import pytest
from lipservo_lab.learning.motion.trained_model import load_trained_model
from spoken_phonemes import spoken

from lipservo.runtime.speech.speech_side import AdjustableMouth
from lipsync.markers import CLOSED_GAP_MM
from lipsync.motion.finishing import STRONGEST
from lipsync.motion.live_synthesizer import LiveSynthesizer
from lipsync.motion.rounding import lip_width_of
from lipsync.phonemes import PhonemeUpdate

MODEL = load_trained_model()
P_BEGINS_S, P_ENDS_S = 2.0, 2.1
SENTENCE = spoken(("AA", P_BEGINS_S), ("P", P_ENDS_S - P_BEGINS_S), ("AA", 1.0), ("SIL", 0.4))
TIMES_S = np.arange(0.0, 3.4, 0.01)


def faces(gain, settings=(), valence=0.0):
    """(n, n_components) at TIMES_S. settings: (time, values)."""
    synthesizer = LiveSynthesizer(MODEL, MODEL.expectation)
    synthesizer.push(PhonemeUpdate(0.0, math.inf, math.inf, SENTENCE))
    mouth, left, shown = AdjustableMouth(synthesizer), list(settings), []
    for time_s in TIMES_S:
        while left and left[0][0] <= time_s:
            mouth.change(left.pop(0)[1])
        mouth.follow(float(time_s), gain, valence)
        shown.append(synthesizer.frame_at(float(time_s)).coefficients)
    return np.array(shown)


def gaps_mm(gain, settings=(), valence=0.0):
    """Between the lips at TIMES_S."""
    return np.array([MODEL.lip_gap_mm(face) for face in faces(gain, settings, valence)])


PLAIN = gaps_mm(1.0)
VOWEL = (TIMES_S > 1.0) & (TIMES_S < 1.7)
P = (TIMES_S > P_BEGINS_S) & (TIMES_S < P_ENDS_S)


@pytest.mark.parametrize("gain", [0.85, 1.2])
def test_vowels_open_by_the_gain_and_a_p_closes_as_ever(gain):
    shown = gaps_mm(gain)
    more = shown[VOWEL].mean() / PLAIN[VOWEL].mean()
    assert (more > 1.05) if gain > 1.0 else (more < 0.95)
    assert shown[P].min() == pytest.approx(PLAIN[P].min(), abs=0.3)
    assert shown[P].min() < CLOSED_GAP_MM


def test_a_valence_that_is_set_widens_the_vowels_of_any_mouth_and_no_closure():
    plain, glad = (MODEL.markers_mm(faces(1.0, valence=v)) for v in (0.0, 1.0))
    width = lip_width_of(MODEL)
    wider_mm = (faces(1.0, valence=1.0) - faces(1.0))[VOWEL] @ width.per_face
    assert wider_mm.mean() > 3.0
    assert MODEL.lip_gaps_mm(glad)[P].min() == pytest.approx(
        MODEL.lip_gaps_mm(plain)[P].min(), abs=0.1
    )


def test_a_gain_that_hardly_changes_moves_nothing():
    np.testing.assert_array_equal(gaps_mm(1.015), PLAIN)


def test_what_a_person_sets_is_multiplied_and_stays_within_what_is_allowed():
    """Strength beyond the most is refused by the synthesiser."""
    softer = gaps_mm(1.2, [(0.0, {"strength": 0.5, "expression": 1.0})])
    strongest = gaps_mm(1.2, [(0.0, {"strength": STRONGEST})])
    assert softer[VOWEL].mean() < PLAIN[VOWEL].mean() < strongest[VOWEL].mean()
