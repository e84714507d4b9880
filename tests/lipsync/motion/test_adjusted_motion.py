"""Strength and smoothness may change while the mouth moves: it goes over, and does not jump."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lipservo_lab.learning.motion.trained_model import load_trained_model
from spoken_phonemes import spoken

from lipsync.motion.finishing import STRONGEST, Style, StyleError
from lipsync.motion.live_synthesizer import LiveSynthesizer
from lipsync.motion.tick_plan import ADJUSTING_S, TICK_S
from lipsync.phonemes import PhonemeUpdate

MODEL = load_trained_model()
SENTENCE = spoken(
    ("SIL", 0.3), ("AA", 0.3), ("IY", 0.2), ("UW", 0.25), ("T", 0.08), ("AE", 0.6), ("SIL", 0.5)
)
STEP_S = 0.005
TIMES_S = np.arange(0.0, 2.2, STEP_S)


def shown(style, changes=()):
    """Return the faces (n, n_components) at TIMES_S of a sentence in `style`, adjusted as it goes.

    changes: (time in s, name of the setting, new value) each, in order of time.
    """
    synthesizer = LiveSynthesizer(MODEL, MODEL.expectation, style)
    synthesizer.push(PhonemeUpdate(0.0, math.inf, math.inf, SENTENCE))
    remaining, faces = list(changes), []
    for time_s in TIMES_S:
        while remaining and remaining[0][0] <= time_s:
            synthesizer.adjust(*remaining.pop(0)[1:])
        faces.append(synthesizer.frame_at(float(time_s)).coefficients)
    return np.array(faces)


def fastest_mm_s(faces):
    markers_mm = MODEL.markers_mm(faces)
    return np.linalg.norm(np.diff(markers_mm, axis=0), axis=2).max() / STEP_S


STRONGEST_FACES = shown(Style(strength=STRONGEST))


@pytest.mark.parametrize(
    ("name", "begun", "set_to"), [("strength", 1.0, 0.3), ("smoothness", 0.0, 1.0)]
)
def test_after_the_change_the_mouth_moves_as_if_it_had_begun_so(name, begun, set_to):
    before, after = shown(Style(**{name: begun})), shown(Style(**{name: set_to}))
    changed = shown(Style(**{name: begun}), [(0.7, name, set_to)])

    # A low-pass filter of 40 ms forgets what it was to 0.1 mm within 0.3 s.
    settled_s = 0.7 + ADJUSTING_S + (0.3 if name == "smoothness" else TICK_S)
    early, late = TIMES_S < 0.7, settled_s < TIMES_S
    np.testing.assert_array_equal(changed[early], before[early])
    off_mm = MODEL.markers_mm(changed[late]) - MODEL.markers_mm(after[late])
    assert np.abs(off_mm).max() < 0.1
    assert not np.allclose(before[late], after[late])


changes = st.tuples(
    st.floats(0.3, 1.6),
    st.sampled_from([("strength", STRONGEST), ("smoothness", 1.0)]),
    st.floats(0.0, 1.0),
).map(lambda drawn: (drawn[0], drawn[1][0], drawn[1][1] * drawn[2]))


@settings(max_examples=15, deadline=None)
@given(st.lists(changes, min_size=1, max_size=6).map(sorted))
def test_no_change_makes_the_mouth_jump(several):
    """However many changes come, and while others are under way.

    The strongest mouth that is never told anything moves at its own speed; easing over its whole
    excursion in 0.3 s adds 1.5 times that in 0.3 s for each change that turns another round.
    """
    rest_mm = MODEL.markers_mm(MODEL.rest[None])
    excursion_mm = np.linalg.norm(MODEL.markers_mm(STRONGEST_FACES) - rest_mm, axis=2).max()
    allowed_mm_s = fastest_mm_s(STRONGEST_FACES) + 3.0 * excursion_mm / ADJUSTING_S

    assert fastest_mm_s(shown(Style(), several)) <= allowed_mm_s


def test_a_time_that_was_shown_is_shown_the_same_again_after_a_change():
    synthesizer = LiveSynthesizer(MODEL, MODEL.expectation)
    synthesizer.push(PhonemeUpdate(0.0, math.inf, math.inf, SENTENCE))
    synthesizer.frame_at(0.7)
    before = synthesizer.frame_at(0.5).coefficients
    synthesizer.adjust("strength", 0.2)

    np.testing.assert_array_equal(synthesizer.frame_at(0.5).coefficients, before)


def test_a_new_stream_begins_with_what_was_set():
    synthesizer = LiveSynthesizer(MODEL, MODEL.expectation)
    synthesizer.adjust("strength", 0.0)
    synthesizer.reset()
    synthesizer.push(PhonemeUpdate(0.0, math.inf, math.inf, SENTENCE))

    np.testing.assert_array_equal(synthesizer.frame_at(0.5).coefficients, MODEL.rest)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("strength", 1.6),
        ("strength", -0.1),
        ("smoothness", 1.1),
        ("lookahead_s", 0.2),
        ("x", 1),
    ],
)
def test_what_cannot_be_adjusted_is_refused(name, value):
    with pytest.raises(StyleError):
        LiveSynthesizer(MODEL, MODEL.expectation).adjust(name, value)
