"""Lag and canonical correlation, on heads whose lag is known, and on the live generators."""

import numpy as np
import pytest
from lipservo_lab.evaluation.expression.expression_figures import (
    NAMES,
    ShownExpression,
    canonical_r,
    canonical_r_shuffled,
    cues_of,
    lag_ms,
    shown,
)
from sklearn.cross_decomposition import CCA
from synthetic_prosody import synthetic_voice

from lipsync.expression.cue import CUE_PERIOD_S
from lipsync.expression.live_expression import LiveExpression


@pytest.fixture(scope="module")
def live():
    return shown(LiveExpression(1), cues_of(synthetic_voice(5, 240.0, 4.0, 0.6)))


def following(lag, noise):
    """A head whose pitch velocity is the loudness of `lag` cues before."""
    rng = np.random.default_rng(0)
    n = 6000
    smooth = np.ones(8) / 8
    loudness, pitch, other = (
        np.convolve(rng.standard_normal(n + 7), smooth, "valid") for _ in range(3)
    )
    values = np.zeros((n, len(NAMES)))
    velocity = np.roll(loudness, lag) + noise * other
    values[:, NAMES.index("neck_pitch_deg")] = np.cumsum(velocity) * CUE_PERIOD_S
    values[:, NAMES.index("neck_yaw_deg")] = np.cumsum(other) * CUE_PERIOD_S
    return ShownExpression(values, np.ones(n, bool), loudness, pitch, np.zeros(n))


@pytest.mark.parametrize("lag", [-5, 0, 7, 30])
def test_the_lag_of_a_head_that_follows_is_found(lag):
    assert lag_ms(following(lag, 0.5)) == pytest.approx(lag * 10.0, abs=10.0)


def test_a_head_that_only_follows_correlates_and_shuffled_it_does_not():
    track = following(7, 0.5)
    assert canonical_r(track, 0.07) > 0.9
    assert canonical_r_shuffled(track, 0.07) < 0.15


def test_canonical_correlation_is_that_of_another_library(live):
    rows = live.is_speaking
    prosody = [live.loudness_z, live.pitch_z]
    prosody += [np.gradient(each, CUE_PERIOD_S) for each in prosody]
    head = [np.gradient(live.column(f"neck_{axis}_deg"), CUE_PERIOD_S) for axis in ("pitch", "yaw")]
    one, other = CCA(1, max_iter=5000, tol=1e-10).fit_transform(
        np.column_stack(prosody)[rows], np.column_stack(head)[rows]
    )
    theirs = np.corrcoef(one[:, 0], other[:, 0])[0, 1]
    assert canonical_r(live) == pytest.approx(theirs, abs=0.002)


def test_the_live_head_lags_the_voice_by_at_most_150_ms(live):
    assert 0.0 <= lag_ms(live) <= 150.0


def test_the_live_head_goes_with_this_voice_and_not_with_any(live):
    lag_s = lag_ms(live) * 1e-3
    assert canonical_r(live, lag_s) > 0.2
    assert canonical_r_shuffled(live, lag_s) < 0.1
