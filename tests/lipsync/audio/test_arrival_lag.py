"""How late the sound of a device is followed: in pieces, behind a buffer, at a rate of its own."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lipsync.audio.playback_clock import ArrivalLag

TICK_S = 1.0 / 30.0


def heard_until_s(now_s: float, *, buffer_s: float, piece_s: float, drift: float) -> float:
    """What a card has handed over by `now_s`."""
    captured_s = max(0.0, now_s - buffer_s) * (1.0 + drift)
    return math.floor(captured_s / piece_s) * piece_s


@given(
    buffer_s=st.floats(0.0, 0.2),
    piece_s=st.sampled_from([0.01, 0.032, 0.064]),
    drift=st.floats(-2e-4, 2e-4),
)
def test_once_settled_no_more_is_expected_than_was_heard_and_not_much_less(
    buffer_s, piece_s, drift
):
    """For ten minutes: the lag lies between what the card just delivered and a piece above it."""
    arrival = ArrivalLag()
    for n in range(round(600.0 / TICK_S)):
        now_s = n * TICK_S
        heard_s = heard_until_s(now_s, buffer_s=buffer_s, piece_s=piece_s, drift=drift)
        before_s = arrival.lag_s
        arrival.observe(now_s, now_s - heard_s)
        assert abs(arrival.lag_s - before_s) <= 0.5 * TICK_S + 1e-12, "the mouth never jumps"
        if now_s > 2.0:
            expected_s = now_s - arrival.lag_s
            assert heard_s - piece_s - TICK_S <= expected_s <= heard_s + 1e-3


FAST_TICK_S = 0.01


def behind_s(duration_s, piece_s, *, jitter_s=0.0, seed=0, pauses=()):
    """Return how many s the newest sound is behind the clock at each tick of 10 ms, (n,).

    piece_s: length of the pieces in which sound arrives, up to `jitter_s` late. pauses: (start,
    length) in s, in which nothing arrives; at their end all comes at once.
    """
    ends_s = np.arange(1, math.ceil(duration_s / piece_s) + 1) * piece_s
    came_s = ends_s + np.random.default_rng(seed).uniform(0.0, jitter_s, len(ends_s))
    for start_s, length_s in pauses:
        came_s = np.where(
            (came_s >= start_s) & (came_s < start_s + length_s), start_s + length_s, came_s
        )
    came_s = np.maximum.accumulate(came_s)
    ticks_s = np.arange(round(duration_s / FAST_TICK_S)) * FAST_TICK_S
    n_come = np.searchsorted(came_s, ticks_s + 1e-9, side="right")
    return ticks_s - n_come * piece_s


def lags_s_of(behind):
    """Return the lag in s that `ArrivalLag` estimates at each tick, (n,); behind: (n,) in s."""
    arrival = ArrivalLag()
    lags_s = []
    for n, each in enumerate(behind):
        arrival.observe(n * FAST_TICK_S, float(each))
        lags_s.append(arrival.lag_s)
    return np.array(lags_s)


@pytest.mark.parametrize(("pause_s", "late_for_s"), [(0.25, 2.0), (1.0, 3.0), (3.0, 5.0)])
def test_a_pause_after_which_all_comes_at_once_is_forgotten_in_seconds(pause_s, late_for_s):
    lags_s = lags_s_of(behind_s(20.0, 0.01, pauses=[(10.0, pause_s)]))
    again = round((10.0 + pause_s) / FAST_TICK_S)

    assert lags_s[again - 1] > 0.4 * pause_s
    assert lags_s[again + round(late_for_s / FAST_TICK_S) :].max() <= 0.045


@settings(max_examples=40)
@given(
    piece_s=st.sampled_from([0.01, 0.032, 0.064]),
    jitter_s=st.floats(0.0, 0.01),
    seed=st.integers(0, 1000),
    pauses=st.lists(st.tuples(st.floats(3.0, 20.0), st.floats(0.05, 3.0)), max_size=4),
)
def test_bursts_and_pauses_neither_make_the_mouth_jump_nor_keep_it_late(
    piece_s, jitter_s, seed, pauses
):
    behind = behind_s(36.0, piece_s, jitter_s=jitter_s, seed=seed, pauses=pauses)
    lags_s = lags_s_of(behind)
    changes_s = np.diff(lags_s)

    assert np.abs(changes_s).max() <= 0.5 * FAST_TICK_S + 1e-12
    assert (lags_s <= np.maximum.accumulate(behind).clip(0.0) + 1e-12).all()
    over_s = max((start_s + length_s for start_s, length_s in pauses), default=0.0)
    settled = round((over_s + 2.0 + lags_s.max() / 0.5) / FAST_TICK_S) + 1
    # No later than a piece with its jitter, and what jitter is allowed for.
    assert lags_s[settled:].max() <= piece_s + jitter_s + FAST_TICK_S + 0.02


@settings(max_examples=40)
@given(jitter_s=st.floats(0.0, 0.01), seed=st.integers(0, 1000))
def test_a_card_that_delivers_large_pieces_with_jitter_does_not_shake_the_mouth(jitter_s, seed):
    """Once settled the lag falls no quicker than clocks drift."""
    lags_s = lags_s_of(behind_s(40.0, 0.064, jitter_s=jitter_s, seed=seed))[500:]

    assert np.diff(lags_s).min() >= -0.0005 * FAST_TICK_S - 1e-12
    assert np.ptp(lags_s) <= jitter_s + FAST_TICK_S
