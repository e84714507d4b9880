import numpy as np
import pytest
from lipservo_lab.learning.learned_expression.learned_expression import (
    BLINK_S,
    LEAST_INTERVAL_S,
    BlinkTiming,
    shut_share,
)
from scipy.stats import kstest


def starts_s(timing, duration_s):
    shut = np.array([timing.shut(0.01 * i) for i in range(round(duration_s * 100))])
    return 0.01 * np.flatnonzero((shut[1:] > 0.0) & (shut[:-1] == 0.0))


def test_a_lid_is_down_after_90_ms_and_up_after_350():
    times_s = np.arange(0.0, 0.5, 0.001)
    shares = np.array([shut_share(t) for t in times_s])

    assert shares.max() == pytest.approx(1.0)
    assert times_s[shares.argmax()] == pytest.approx(0.090, abs=0.002)
    assert times_s[shares > 0.0].max() == pytest.approx(BLINK_S, abs=0.002)
    assert np.abs(np.diff(shares)).max() < 0.02  # no jump


def test_intervals_are_log_normal():
    begun = starts_s(BlinkTiming(1.5, 0.4, np.random.default_rng(0)), 3000.0)
    logs = (np.log(np.diff(begun)) - 1.5) / 0.4

    assert len(begun) > 400
    assert kstest(logs, "norm").pvalue > 0.01


def test_no_interval_is_shorter_than_a_blink():
    begun = starts_s(BlinkTiming(-2.0, 1.5, np.random.default_rng(0)), 100.0)

    assert np.diff(begun).min() > LEAST_INTERVAL_S - 0.011


def test_a_jump_of_time_makes_one_blink_not_many():
    timing = BlinkTiming(0.0, 0.1, np.random.default_rng(0))
    timing.shut(0.0)
    timing.shut(5000.0)

    assert len(starts_s_after(timing, 5000.01, 10.0)) < 15


def starts_s_after(timing, first_s, duration_s):
    shut = np.array([timing.shut(first_s + 0.01 * i) for i in range(round(duration_s * 100))])
    return np.flatnonzero((shut[1:] > 0.0) & (shut[:-1] == 0.0))
