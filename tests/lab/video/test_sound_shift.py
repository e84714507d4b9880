"""How late the sound is, per clip and for a session."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lipservo_lab.video.sound_shift import corrections_s, correlation, shift_curve


def gaps(seed, n=400):
    """(n,) every 10 ms: what a mouth does, syllables of 150 ms."""
    rng = np.random.default_rng(seed)
    smooth = np.convolve(rng.normal(size=n + 60), np.hanning(31), "same")[30:-30]
    return 5 + smooth


def curve_of(seed, late_s, noise=0.0):
    expected = gaps(seed)
    times_s = np.arange(80) / 25.0 + 0.3
    seen = np.interp(times_s + late_s, np.arange(len(expected)) * 0.01, expected)
    return shift_curve(seen + np.random.default_rng(9).normal(0, noise, 80), times_s, expected)


@settings(max_examples=10, deadline=None)
@given(st.floats(-0.3, 0.3), st.integers(0, 50))
def test_a_known_shift_is_found_to_a_few_milliseconds(late_s, seed):
    assert curve_of(seed, late_s).best_s == pytest.approx(late_s, abs=5e-3)


def test_a_session_has_one_shift_and_noise_of_single_clips_is_not_followed():
    curves = [curve_of(seed, 0.06 + jitter, 0.5) for seed, jitter in enumerate((-0.02, 0, 0.02))]
    assert corrections_s(curves) == pytest.approx([curves[1].best_s] * 3)
    assert curves[1].best_s == pytest.approx(0.06, abs=0.02)


def test_a_clip_far_from_the_others_has_its_own():
    found = corrections_s([curve_of(seed, late) for seed, late in enumerate((0, 0, 0, 0.2))])
    assert found[:3] == [0.0, 0.0, 0.0]
    assert found[3] == pytest.approx(0.2, abs=0.01)


def test_clips_that_say_nothing_move_nothing():
    rng = np.random.default_rng(0)
    deaf = shift_curve(rng.normal(size=80), np.arange(80) / 25.0, gaps(3))
    assert corrections_s([deaf]) == [0.0]


def test_correlation_is_numpys():
    one, other = np.random.default_rng(0).normal(size=(2, 50))
    assert correlation(one, other) == pytest.approx(np.corrcoef(one, other)[0, 1])
    assert correlation(one, np.ones(50)) == 0.0
