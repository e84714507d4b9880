"""Intervals of few robots, beside tables and SciPy."""

import numpy as np
import pytest
from lipservo_lab.bench.calibration.intervals import median_interval, share_interval
from scipy.stats import binomtest


def test_of_twenty_values_the_sixth_and_the_fifteenth_hold_the_median():
    """Tables of the binomial distribution: 95.9 %."""
    values = np.random.default_rng(0).permutation(np.arange(1, 21)).tolist()
    assert median_interval(values) == [6.0, 15.0]


def test_of_few_values_the_range_is_all_there_is():
    assert median_interval([3.0, 1.0, 2.0]) == [1.0, 3.0]
    assert np.isnan(median_interval([])).all()


@pytest.mark.parametrize(("n_of", "n"), [(0, 20), (17, 20), (20, 20), (1, 3)])
def test_shares_are_those_of_scipy(n_of, n):
    wilson = binomtest(n_of, n).proportion_ci(method="wilson")
    assert share_interval(n_of, n) == pytest.approx([wilson.low, wilson.high])


def test_of_nothing_every_share_is_possible():
    assert share_interval(0, 0) == [0.0, 1.0]
