"""The published synthesiser as its callers see it: continuous, on time, closed in silence."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from small_model import small_model
from spoken_phonemes import spoken, update_streams

from lipsync.animpho.selection import STRATEGIES, NaiveSelection
from lipsync.animpho.synthesizer import PublishedSynthesizer
from lipsync.phonemes import PHONEMES, PhonemeEvent, PhonemeUpdate

SPOKEN = ("SIL", "M", "AA", "IY", "UW")


def saying(*phones: tuple[str, float], **options) -> PublishedSynthesizer:
    synthesizer = PublishedSynthesizer(small_model().animphos, **options)
    synthesizer.push(PhonemeUpdate(0.0, math.inf, math.inf, spoken(*phones)))
    return synthesizer


def around(synthesizer: PublishedSynthesizer, time_s: float) -> tuple[float, float, float]:
    """Jump at a joint, and the speeds just before and after it, on the opening component."""
    step_s = 1e-6
    times_s = (time_s - 2 * step_s, time_s - step_s, time_s, time_s + step_s)
    a, b, c, d = (synthesizer.frame_at(t).coefficients[0] for t in times_s)
    return c - b, (b - a) / step_s, (d - c) / step_s


CHAIN = (("SIL", 0.5), ("M", 0.08), ("AA", 0.16), ("IY", 0.05), ("UW", 0.30), ("SIL", 0.6))
JOINTS_S = (0.58, 0.74, 0.79)


@pytest.mark.parametrize("strategy", STRATEGIES.values(), ids=STRATEGIES.keys())
@pytest.mark.parametrize("joint_s", JOINTS_S)
def test_position_and_speed_are_continuous_at_every_joint(strategy, joint_s):
    jump, before, after = around(saying(*CHAIN, strategy=strategy), joint_s)
    assert abs(jump) < 1e-2
    assert after == pytest.approx(before, rel=1e-3, abs=0.5)


def test_published_mode_keeps_the_derivative_per_sample_spacing():
    """AA 160 ms, then IY 50 ms: the same derivative per spacing is 3.2 times the speed."""
    jump, before, after = around(saying(*CHAIN, published_derivatives=True), 0.74)
    assert abs(jump) < 1e-2
    assert abs(before) > 10.0
    assert after == pytest.approx(before * 0.16 / 0.05, rel=1e-2)


def test_a_long_pause_ends_in_closed_lips():
    model = small_model()
    synthesizer = saying(("SIL", 0.4), ("AA", 0.2), ("SIL", 1.0))
    assert model.lip_gap_mm(synthesizer.frame_at(0.55).coefficients) > 5.0
    for time_s in (0.85, 1.2, 1.59, 30.0):
        np.testing.assert_allclose(synthesizer.frame_at(time_s).coefficients, model.rest, atol=1e-9)


def test_a_short_silence_between_words_is_a_phoneme_like_any_other():
    synthesizer = saying(("AA", 0.2), ("SIL", 0.2), ("AA", 0.2))
    synthesizer.frame_at(0.59)
    assert synthesizer.phonemes_planned == 3


def test_a_phone_that_goes_on_is_played_for_its_longest_time_and_then_held():
    synthesizer = PublishedSynthesizer(small_model().animphos, longest_phone_s=0.35)
    synthesizer.push(PhonemeUpdate(0.0, 9.0, 8.9, (PhonemeEvent("AA", 0.0, None),)))
    held = synthesizer.frame_at(1.0).coefficients
    np.testing.assert_array_equal(held, synthesizer.frame_at(8.0).coefficients)
    assert synthesizer.phonemes_planned == 1


def test_the_same_time_gives_the_same_face_also_after_a_look_back():
    synthesizer = saying(*CHAIN)
    faces = {t: synthesizer.frame_at(t).coefficients for t in (0.60, 0.65, 0.80)}
    for time_s, face in faces.items():
        np.testing.assert_array_equal(face, synthesizer.frame_at(time_s).coefficients)


def test_what_was_shown_is_not_taken_back_and_what_comes_joins_on():
    synthesizer = PublishedSynthesizer(small_model().animphos)
    first = (PhonemeEvent("SIL", 0.0, 0.5), PhonemeEvent("AA", 0.5, None))
    synthesizer.push(PhonemeUpdate(0.0, 0.9, 0.0, first))
    shown = synthesizer.frame_at(0.7).coefficients
    other = (("SIL", 0.0, 0.4), ("UW", 0.4, 0.72), ("M", 0.72, None))
    events = tuple(PhonemeEvent(*each) for each in other)
    synthesizer.push(PhonemeUpdate(0.0, 1.3, 0.0, events))
    np.testing.assert_array_equal(shown, synthesizer.frame_at(0.7).coefficients)
    jump, before, after = around(synthesizer, 0.85)
    assert abs(jump) < 1e-2
    assert after == pytest.approx(before, rel=1e-3, abs=0.5)


def test_every_phoneme_of_the_inventory_moves_the_mouth():
    for phoneme in set(PHONEMES) - {"SIL"}:
        said = (("SIL", 0.4), (phoneme, 0.2), ("AA", 0.2), ("SIL", 0.5))
        synthesizer = saying(*said, strategy=NaiveSelection())
        frames = np.array([synthesizer.frame_at(0.4 + 0.01 * i).coefficients for i in range(20)])
        assert np.ptp(frames, axis=0).max() > 0.1, phoneme


def test_nothing_heard_yet_is_a_closed_mouth():
    model = small_model()
    synthesizer = PublishedSynthesizer(model.animphos)
    for time_s in (0.0, 0.1, 100.0):
        np.testing.assert_array_equal(synthesizer.frame_at(time_s).coefficients, model.rest)


@settings(max_examples=60, deadline=None)
@example([PhonemeUpdate(0.5, 0.5, 0.5, (PhonemeEvent("AW", 0.5, 0.5205),))])
@given(update_streams())
def test_motion_stays_continuous_whatever_arrives(updates):
    """Frames 1 ms apart never differ by more than the fastest AnimPho can move in that time."""
    synthesizer = PublishedSynthesizer(small_model().animphos)
    frames, shown_s = [], 0.0
    for update in updates:
        synthesizer.push(update)
        while shown_s < update.heard_until_s - 0.4:
            frames.append(synthesizer.frame_at(shown_s).coefficients)
            shown_s += 0.001
    for _ in range(700):
        frames.append(synthesizer.frame_at(shown_s).coefficients)
        shown_s += 0.001
    steps = np.abs(np.diff(np.array(frames), axis=0))
    # 50 is the range of the small model, 20 ms the shortest stretch that is animated: four spans
    # between five samples. Halfway through a span a Hermite curve is as steep as 1.5 of its rise
    # less a quarter of the slopes at its ends. The first slope is carried over and may be the
    # steepest of all, the other way: s = 1.5 + s / 4 = 2 ranges a span, 8 a stretch.
    assert np.isfinite(steps).all()
    assert steps.max() <= 50.0 * 8 / 20.0
