"""Lag on heads whose lag is known; lag and canonical correlation on the live generators."""

import numpy as np
import pytest
from lipservo_lab.evaluation.expression.expression_figures import (
    NAMES,
    ShownExpression,
    cues_of,
    expression_figures,
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


def canonical_correlation(voice, moves):
    """The correlation of the two directions (n, 4) and (n, 2) that correlate most."""
    return np.corrcoef(*(each[:, 0] for each in CCA(n_components=1).fit_transform(voice, moves)))[
        0, 1
    ]


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
    return ShownExpression(values, np.ones(n, bool), loudness, pitch)


@pytest.mark.parametrize("lag", [-5, 0, 7, 30])
def test_the_lag_of_a_head_that_follows_is_found(lag):
    assert lag_ms(following(lag, 0.5)) == pytest.approx(lag * 10.0, abs=10.0)


def test_the_live_head_lags_the_voice_by_at_most_150_ms(live):
    assert 0.0 <= lag_ms(live) <= 150.0


def test_the_live_head_goes_with_this_voice_and_not_with_any(live):
    lag = round(lag_ms(live) * 1e-3 / CUE_PERIOD_S)
    prosody = [live.loudness_z, live.pitch_z]
    prosody += [np.gradient(each, CUE_PERIOD_S) for each in prosody]
    head = [np.gradient(live.column(f"neck_{axis}_deg"), CUE_PERIOD_S) for axis in ("pitch", "yaw")]
    rows = live.is_speaking.copy()
    rows[len(rows) - lag :] = False
    voice = np.column_stack(prosody)[rows]
    moves = np.column_stack([np.roll(each, -lag) for each in head])[rows]
    assert canonical_correlation(voice, moves) > 0.2
    shifts = np.random.default_rng(0).integers(500, len(moves) - 500, 20)
    elsewhere = [canonical_correlation(np.roll(voice, s, axis=0), moves) for s in shifts]
    assert np.mean(elsewhere) < 0.1


def test_a_voice_without_a_frame_measures_nothing():
    with pytest.raises(ValueError, match="0 frames"):
        expression_figures(lambda: None, [])
