"""Joints moved slowly from one pose to another."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_bridge.gate.ramp import EASE_PEAK_SLOPE, EaseToNeutral, Ramp
from firmware_bridge.joints import Joint

DEGREES = st.lists(st.floats(-180.0, 180.0), min_size=3, max_size=3).map(np.array)


def test_the_joint_with_the_longest_way_moves_at_the_speed_and_all_arrive_together():
    ramp = Ramp.at_speed(np.array([0.0, 10.0]), np.array([30.0, 5.0]), 100.0, 15.0)
    assert ramp.duration_s == 2.0
    assert ramp.at(99.0).tolist() == [0.0, 10.0]
    assert ramp.at(101.0).tolist() == [15.0, 7.5]
    assert not ramp.is_over(101.999)
    assert ramp.at(102.0).tolist() == [30.0, 5.0]
    assert ramp.is_over(102.0)


def test_a_ramp_to_where_the_joints_are_is_over_at_once():
    here = np.array([3.0, -4.0])
    ramp = Ramp.at_speed(here, here, 5.0, 30.0)
    assert ramp.is_over(5.0)
    assert ramp.at(5.0).tolist() == [3.0, -4.0]


@given(DEGREES, DEGREES, st.floats(0.01, 10.0), st.booleans())
def test_a_ramp_stays_between_its_ends_and_ends_exactly_at_its_goal(start, goal, lasts_s, eased):
    ramp = Ramp(start, goal, 0.0, lasts_s, eased=eased)
    asked = np.array([ramp.at(time_s) for time_s in np.linspace(-0.1, lasts_s, 50)])
    low, high = np.minimum(start, goal), np.maximum(start, goal)
    assert (asked >= low - 1e-9).all()
    assert (asked <= high + 1e-9).all()
    assert asked[-1].tolist() == goal.tolist()


@given(DEGREES, DEGREES)
def test_an_eased_ramp_rests_at_both_ends_and_is_fastest_in_the_middle(start, goal):
    ramp = Ramp(start, goal, 0.0, 1.0, eased=True)
    steps = [np.abs(ramp.at(t + 1e-4) - ramp.at(t)) / 1e-4 for t in (0.0, 0.49995, 0.9999)]
    way_deg = np.abs(goal - start)
    assert steps[0] == pytest.approx(0.0 * way_deg, abs=0.3)
    assert steps[1] == pytest.approx(EASE_PEAK_SLOPE * way_deg, abs=1e-3)
    assert steps[2] == pytest.approx(0.0 * way_deg, abs=0.3)


JOINTS = [Joint("jaw", 0, -30.0, 30.0, 300.0), Joint("lip", 1, -30.0, 30.0, 30.0)]
BOTH = np.array([True, True])


@pytest.mark.parametrize(
    ("left_deg", "arrives"), [(0.0, True), (5e-324, True), (-1e-7, True), (1e-5, False)]
)
def test_a_soft_stop_has_arrived_where_rounding_alone_is_left_of_the_way(left_deg, arrives):
    easing = EaseToNeutral(JOINTS, np.array([30.0, 0.0]), 10.0)
    sent_deg = np.array([0.0, left_deg])
    assert not easing.over(sent_deg, BOTH, 10.499)
    assert easing.over(sent_deg, BOTH, 10.5) is arrives
    assert easing.arrived is arrives


def test_a_soft_stop_takes_the_time_of_its_slowest_joint_and_two_seconds_at_most():
    easing = EaseToNeutral(JOINTS, np.array([30.0, -30.0]), 10.0)
    assert easing.at(10.75)[1] == pytest.approx(-15.0)
    assert not easing.over(np.zeros(2), BOTH, 11.499)
    assert easing.over(np.zeros(2), BOTH, 11.5)

    far_deg = np.array([0.0, -9.0])
    assert not easing.over(far_deg, BOTH, 11.999)
    assert easing.over(far_deg, BOTH, 12.0)
    assert not easing.arrived
