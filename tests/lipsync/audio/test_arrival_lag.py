"""How late the sound of a device is followed: in pieces, behind a buffer, at a rate of its own."""

import math

from hypothesis import given
from hypothesis import strategies as st

from lipsync.audio.arrival_lag import ArrivalLag

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
