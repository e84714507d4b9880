"""Acceleration limits, and rules between joints."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_bridge.gate.limits import Limiter, Prevention, PreventRule, braking_speed
from firmware_bridge.joints import Joint

PERIOD_S = 0.01
JOINT = Joint("jaw", 1, -10.0, 20.0, 300.0, max_acceleration_deg_s2=6000.0)


def steps(limiter, wanted):
    sent = [limiter.sent_deg.copy()]
    for n, goal_deg in enumerate(wanted, 1):
        sent.append(limiter.apply(np.atleast_1d(goal_deg), n * PERIOD_S).positions_deg)
    return np.array(sent)


def test_braking_speed_stops_exactly_on_the_grid():
    """With a = 1, step 1: from speed 3 the steps 3, 2, 1 need 6; from 2.5: 2.5, 1.5, 0.5 = 4.5."""
    one = np.ones(1)

    assert braking_speed(np.array([6.0]), one, 1.0) == pytest.approx([3.0])
    assert braking_speed(np.array([4.5]), one, 1.0) == pytest.approx([2.5])
    assert braking_speed(np.array([-1.0]), one, 1.0) == pytest.approx([0.0])


@settings(max_examples=150, deadline=None)
@given(st.lists(st.floats(-60.0, 60.0), min_size=1, max_size=120))
def test_speed_acceleration_and_range_hold_whatever_is_asked(wanted):
    limiter = Limiter([JOINT], PERIOD_S)
    limiter.start_from(np.array([0.0]), 0.0)
    sent = steps(limiter, wanted)[:, 0]
    speed = np.diff(sent) / PERIOD_S
    acceleration = np.diff(np.concatenate([[0.0], speed])) / PERIOD_S

    assert sent.min() >= -10.0 - 1e-9
    assert sent.max() <= 20.0 + 1e-9
    assert np.abs(speed).max() <= 300.0 + 1e-6
    assert np.abs(acceleration).max() <= 6000.0 * (1 + 1e-6)


def test_a_step_is_reached_without_overshoot():
    limiter = Limiter([JOINT], PERIOD_S)
    limiter.start_from(np.array([0.0]), 0.0)
    sent = steps(limiter, [15.0] * 60)[:, 0]

    assert sent.max() <= 15.0 + 1e-9
    assert sent[-1] == pytest.approx(15.0, abs=1e-6)


def test_a_smooth_motion_within_the_limits_passes_unchanged():
    limiter = Limiter([JOINT], PERIOD_S)
    limiter.start_from(np.array([0.0]), 0.0)
    time_s = np.arange(1, 200) * PERIOD_S
    wanted = 5.0 * (1.0 - np.cos(2.0 * np.pi * 2.0 * time_s))

    np.testing.assert_allclose(steps(limiter, wanted)[1:, 0], wanted, atol=0.02)


RULE = PreventRule((1.0, 1.0), 30.0, "the lip would touch the jaw")


@settings(max_examples=150, deadline=None)
@given(st.lists(st.tuples(st.floats(-50, 50), st.floats(-50, 50)), min_size=1, max_size=60))
def test_forbidden_combinations_are_never_sent(wanted):
    joints = [Joint(name, n, -20.0, 25.0, 300.0) for n, name in enumerate(("jaw", "lip"))]
    limiter = Limiter(joints, PERIOD_S, [RULE])
    limiter.start_from(np.zeros(2), 0.0)

    assert steps(limiter, [np.array(pair) for pair in wanted]).sum(axis=1).max() <= 30.0 + 1e-6


def test_a_rule_broken_by_hand_may_be_left_but_not_entered_further():
    prevention = Prevention([RULE], 2)
    broken = np.array([20.0, 20.0])

    np.testing.assert_array_equal(prevention.cut(broken, np.array([19.0, 20.0])), [19.0, 20.0])
    np.testing.assert_array_equal(prevention.cut(broken, np.array([21.0, 20.0])), broken)


def test_a_rule_must_allow_neutral():
    with pytest.raises(ValueError, match="must allow neutral"):
        Prevention([PreventRule((1.0, 0.0), -1.0, "?")], 2)


@pytest.mark.parametrize(
    ("wanted_deg", "least_deg", "most_deg"), [([0.0, 20.0], 10.0, 10.0), ([25.0, 0.0], 0.0, 10.0)]
)
def test_a_limp_joint_counts_where_it_stands_whatever_is_wanted_of_it(
    wanted_deg, least_deg, most_deg
):
    joints = [Joint(name, n, -20.0, 25.0, 300.0) for n, name in enumerate(("jaw", "lip"))]
    limiter = Limiter(joints, PERIOD_S, [RULE])
    limiter.start_from(np.array([20.0, 10.0]), 0.0)
    sent_deg = []
    for n in range(1, 51):
        limiter.follow(np.array([True, False]), np.array([20.0, np.nan]))
        sent_deg.append(limiter.apply(np.array(wanted_deg), n * PERIOD_S).positions_deg[1])

    assert max(sent_deg) <= most_deg + 1e-6
    assert sent_deg[-1] == pytest.approx(least_deg, abs=1e-6)
