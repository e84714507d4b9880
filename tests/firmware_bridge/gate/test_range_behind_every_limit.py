"""Behind speed, acceleration and rules a goal is in its range, or no farther out than before."""

import math
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_bridge.gate import limits
from firmware_bridge.gate.limits import Limiter, PreventRule
from firmware_bridge.joints import Joint, JointPulse

PERIOD_S = 0.01
BROW_PULSE = JointPulse(neutral_us=1500.0, us_per_deg=10.0, min_us=1300.0, max_us=1650.0)
#: One joint of each sort: limited in acceleration, not limited, and one that may be widened.
JOINTS = [
    Joint("jaw", 0, -10.0, 20.0, 300.0, max_acceleration_deg_s2=6000.0),
    Joint("lip", 1, -30.0, 40.0, 400.0),
    Joint("brow", 2, -20.0, 15.0, 200.0, max_acceleration_deg_s2=3000.0, pulse=BROW_PULSE),
]
RULES = [
    PreventRule((1.0, 0.3, 0.0), 17.0, "the lip would touch the jaw"),
    PreventRule((-1.0, 0.0, 1.0), 9.0, "the brow would touch the jaw"),
]

angles = st.floats(-70.0, 70.0)
poses = st.tuples(angles, angles, angles).map(np.array)
three_flags = st.tuples(st.booleans(), st.booleans(), st.booleans()).map(np.array)
#: What happens before some ticks: a target that runs on by degrees a tick from a pose, and so on.
events = st.one_of(
    st.tuples(st.just("run"), poses, poses.map(lambda pose_deg: pose_deg / 15.0)),
    st.tuples(st.just("stay"), poses),
    st.tuples(st.just("no number"), st.sampled_from([math.nan, math.inf, -math.inf])),
    st.tuples(st.just("widen"), st.floats(0.0, 95.0)),
    st.tuples(st.just("hold back"), three_flags),
    st.tuples(st.just("follow"), three_flags, poses),
    st.tuples(st.just("start one"), st.integers(0, 2), angles),
    st.tuples(st.just("stall"), st.floats(-0.1, 0.5)),
)


@pytest.mark.parametrize("error", [1.0, 1.025, 3.0], ids="braking speed x {}".format)
@settings(max_examples=60, deadline=None)
@given(
    start_deg=poses,
    what=st.lists(st.tuples(events, st.integers(1, 12)), max_size=20),
    rules=st.sampled_from([[], RULES]),
)
def test_a_goal_is_in_its_range_or_no_farther_out_whatever_comes(error, start_deg, what, rules):
    right = limits.braking_speed
    limiter = Limiter(JOINTS, PERIOD_S, rules)
    limiter.start_from(start_deg, 0.0)
    low_deg, high_deg = np.array([-10.0, -30.0, -20.0]), np.array([20.0, 40.0, 15.0])
    wanted_deg, move_deg, time_s = start_deg, np.zeros(3), 0.0
    with patch.object(limits, "braking_speed", lambda *args: error * right(*args)):
        for (kind, *values), n_ticks in what:
            if kind in ("run", "stay", "no number"):
                wanted_deg = np.broadcast_to(values[0], 3)
                move_deg = values[1] if kind == "run" else np.zeros(3)
            elif kind == "widen":
                limiter.widen(np.full(3, -values[0]), np.full(3, values[0]))
                low_deg[2], high_deg[2] = -np.clip(values[0], 20, 90), np.clip(values[0], 15, 90)
            elif kind == "hold back":
                limiter.hold_back(None if values[0].all() else values[0])
            elif kind == "follow":
                limiter.follow(*values)
            elif kind == "start one":
                limiter.start_one(*values)
            else:
                time_s += values[0]
            for _ in range(n_ticks):
                time_s, wanted_deg = time_s + PERIOD_S, wanted_deg + move_deg
                before_deg = limiter.sent_deg
                sent_deg = limiter.apply(wanted_deg, time_s).positions_deg

                assert (sent_deg >= np.minimum(low_deg, before_deg)).all()
                assert (sent_deg <= np.maximum(high_deg, before_deg)).all()
                assert sent_deg is limiter.sent_deg


def test_not_even_rules_that_lengthen_a_step_lead_out_of_the_range():
    limiter = Limiter(JOINTS[:1], PERIOD_S)
    limiter.start_from(np.array([18.0]), 0.0)
    with patch.object(limits.Prevention, "cut", lambda _, a, b: a + 100.0 * (b - a)):
        sent_deg = limiter.apply(np.array([20.0]), PERIOD_S).positions_deg

    assert sent_deg.tolist() == [20.0]


@settings(max_examples=200, deadline=None)
@given(
    start_deg=st.floats(-10.0, 20.0),
    speed_deg_s=st.floats(20.0, 300.0),
    direction=st.sampled_from([1.0, -1.0]),
)
def test_a_target_that_runs_on_through_the_end_is_braked_to_rest_there(
    start_deg, speed_deg_s, direction
):
    limiter = Limiter(JOINTS[:1], PERIOD_S)
    limiter.start_from(np.array([start_deg]), 0.0)
    n = np.arange(1, 200)
    wanted_deg = start_deg + direction * speed_deg_s * PERIOD_S * n
    pairs = zip(wanted_deg, n * PERIOD_S, strict=True)
    sent_deg = [limiter.apply(np.array([deg]), s).positions_deg[0] for deg, s in pairs]
    speeds_deg_s = np.diff([start_deg, start_deg, *sent_deg]) / PERIOD_S

    assert sent_deg[-1] == pytest.approx(20.0 if direction > 0.0 else -10.0, abs=1e-6)
    assert np.abs(np.diff(speeds_deg_s)).max() / PERIOD_S <= 6000.0 * (1.0 + 1e-6)
