"""When eyes blink by themselves, and the shape of a blink."""

import math
from random import Random

import numpy as np
import pytest
from scipy import stats

from lipsync.expression.blinks import SIGMA, Blinks, closure
from lipsync.expression.cue import CUE_PERIOD_S


def onsets(blinks, n_cues, rate_per_min=20.0, **fields):
    given = {"speech_ended": False, "saccade_deg": 0.0, **fields}
    shut = np.array([blinks.step(rate_per_min, **given) for _ in range(n_cues)])
    return np.flatnonzero((shut[1:] >= 1.0) & (shut[:-1] < 1.0)) * CUE_PERIOD_S


def test_intervals_between_blinks_are_log_normal():
    intervals_s = np.diff(onsets(Blinks(Random(1)), 240_000))
    # Half a cue of sampling is added; the few that the refractory time cuts off are left out.
    cut = intervals_s[intervals_s > 0.5] - CUE_PERIOD_S / 2
    whole = stats.lognorm(SIGMA, scale=3.0 * math.exp(-(SIGMA**2) / 2))
    below = whole.cdf(0.5)
    found = stats.kstest(cut, lambda x: (whole.cdf(x) - below) / (1 - below))
    assert len(cut) > 600
    assert found.pvalue > 0.05


def test_a_blink_is_faster_down_than_up_and_shut_between():
    assert closure(0.0) == 0.0
    assert closure(0.045) == pytest.approx(0.5)
    assert closure(0.09) == closure(0.10) == closure(0.11) == 1.0
    assert closure(0.23) == pytest.approx(0.5)
    assert closure(0.36) == 0.0


def test_the_larger_a_saccade_the_likelier_a_blink():
    def share(saccade_deg):
        n = 0
        for seed in range(400):
            blinks = Blinks(Random(f"{seed}"))
            blinks.step(1e-6, False, saccade_deg)
            n += blinks.step(1e-6, False, 0.0) > 0.0
        return n / 400

    assert share(5.0) == 0.0
    assert share(19.0) == pytest.approx(0.5, abs=0.08)
    assert share(40.0) == pytest.approx(0.97, abs=0.03)


def test_at_rate_0_no_blink_begins():
    assert len(onsets(Blinks(Random(1)), 20_000, 0.0, speech_ended=True, saccade_deg=40.0)) == 0
