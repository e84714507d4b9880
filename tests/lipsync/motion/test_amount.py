"""A smooth curve from anywhere to 0 or 1."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from lipsync.motion.finishing import CLOSING_S
from lipsync.motion.tick_plan import Amount


@given(st.floats(0.0, 1.0), st.floats(-40.0, 40.0), st.sampled_from([0.0, 1.0]))
def test_an_amount_starts_where_the_last_one_was_and_ends_at_its_goal(value, slope, goal):
    amount = Amount(2.0, CLOSING_S, value, slope, goal)
    assert amount.at(2.0) == pytest.approx((value, slope))
    assert amount.at(2.0 + CLOSING_S) == (goal, 0.0)
    nearly = amount.at(2.0 + CLOSING_S - 1e-9)
    assert nearly == pytest.approx((goal, 0.0), abs=1e-3)
