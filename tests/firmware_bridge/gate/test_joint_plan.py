"""Joints that start early: limits are kept, what must be met is met, and nothing lags behind."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import optimize

from firmware_bridge.gate.joint_plan import JointPlan, TargetWindow

PERIOD_S = 0.01
SPEED_DEG_S = 200.0
STEP_DEG = SPEED_DEG_S * PERIOD_S


def plan_of(acceleration_deg_s2=math.inf):
    return JointPlan(np.array([SPEED_DEG_S]), np.array([acceleration_deg_s2]), PERIOD_S)


def window(wanted_deg, must_meet=(), n_ahead=10):
    """Of a whole motion, one angle each period, what lies between n and n + n_ahead."""

    def at(n):
        rows = np.minimum(np.arange(n, n + n_ahead + 1), len(wanted_deg) - 1)
        must = np.isin(rows, must_meet)
        return TargetWindow(
            np.arange(n_ahead + 1) * PERIOD_S, np.array(wanted_deg)[rows][:, None], must
        )

    return at


def planned_deg(wanted_deg, must_meet=(), n_ahead=10, acceleration_deg_s2=math.inf):
    plan, at = plan_of(acceleration_deg_s2), window(wanted_deg, must_meet, n_ahead)
    return np.array([plan.step(at(n))[0] for n in range(len(wanted_deg))])


def test_a_motion_within_the_limits_passes_as_it_is():
    wanted_deg = 5.0 * np.sin(np.arange(100) * 0.1)

    assert planned_deg(wanted_deg) == pytest.approx(wanted_deg)


def test_a_pose_that_must_be_met_is_started_early_enough():
    """20 degrees in one tick need ten at 200 degrees a second."""
    wanted_deg = np.where(np.arange(60) < 30, 18.0, 0.0)

    assert planned_deg(wanted_deg, must_meet=(30,))[30] == pytest.approx(0.0, abs=1e-9)
    assert planned_deg(wanted_deg, must_meet=(30,), n_ahead=0)[30] > 15.0


def test_a_step_is_begun_before_it_is_due():
    """A limit that looks back alone is late by half of the way, 50 ms of 100."""
    wanted_deg = np.where(np.arange(60) < 30, 0.0, 20.0)

    def half_way(n_ahead):
        return np.interp(10.0, planned_deg(wanted_deg, n_ahead=n_ahead), np.arange(60))

    assert half_way(0) == pytest.approx(34.5, abs=0.5)
    assert 29.5 <= half_way(20) <= 32.0


def test_what_is_too_fast_is_mended_by_the_least_squares():
    """By SciPy's solver, within what three sweeps leave, of poses 10 ms apart."""
    wanted_deg = np.array([0.0, 3.0, 9.0, 2.0, 2.0])
    between = optimize.LinearConstraint(np.diff(np.eye(5), axis=0), -1.98, 1.98)
    best = optimize.minimize(
        lambda x: np.sum((x - wanted_deg) ** 2), wanted_deg, constraints=between, method="SLSQP"
    )
    found_deg = plan_of().step(window(wanted_deg, n_ahead=4)(0))

    assert found_deg[0] == pytest.approx(best.x[0], abs=0.4)


def test_a_mouth_opens_no_farther_than_it_can_close_with_the_notice_it_gets():
    plan = plan_of()
    far = np.full((11, 1), 80.0)
    urgent_deg = np.zeros(1)
    for _ in range(100):
        window_ = TargetWindow(np.arange(11) * PERIOD_S, far, np.zeros(11, bool), urgent_deg)
        goal_deg = plan.step(window_)

    assert SPEED_DEG_S * 0.1 < goal_deg[0] < SPEED_DEG_S * 0.2
    assert plan.held_back_share[0] == 1.0


ANGLES = st.lists(st.floats(-60.0, 60.0), min_size=2, max_size=60)


@given(ANGLES, st.sets(st.integers(0, 59), max_size=5), st.integers(0, 20))
def test_no_step_is_beyond_the_speed_whatever_is_wanted(wanted_deg, must_meet, n_ahead):
    found_deg = planned_deg(wanted_deg, tuple(must_meet), n_ahead)

    assert np.abs(np.diff(found_deg)).max() <= STEP_DEG
    assert found_deg.min() >= min(wanted_deg) - 1e-9
    assert found_deg.max() <= max(wanted_deg) + 1e-9


@given(ANGLES, st.integers(0, 20))
def test_no_speed_changes_faster_than_a_joint_may(wanted_deg, n_ahead):
    found_deg = planned_deg(wanted_deg, n_ahead=n_ahead, acceleration_deg_s2=4_000.0)
    speeds = np.diff(found_deg) / PERIOD_S

    assert np.abs(np.diff(speeds)).max(initial=0.0) <= 4_000.0 * PERIOD_S + 1e-6
