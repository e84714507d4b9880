import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_bridge.gate.limits import Limiter
from firmware_bridge.gate.ramp import EASE_PEAK_SLOPE, StaleLevel, StaleRule, ease
from firmware_bridge.joints import Joint

JAW = Joint("jaw", 1, min_deg=-2.0, max_deg=25.0, max_speed_deg_s=300.0)
LIP = Joint("lip", 2, min_deg=-30.0, max_deg=40.0, max_speed_deg_s=400.0)
PERIOD_S = 0.01


def jaw_at(position_deg):
    limiter = Limiter([JAW], PERIOD_S)
    limiter.start_from(np.array([position_deg]), 0.0)
    return limiter


@pytest.mark.parametrize(
    ("wanted_deg", "sent_deg", "is_hit"),
    [
        (24.999999, 24.999999, False),
        (25.0, 25.0, False),
        (25.0 + 1e-9, 25.0, False),  # rounding, not a violation
        (25.0 + 1e-5, 25.0, True),
        (26.0, 25.0, True),
        (1e300, 25.0, True),
    ],
)
def test_a_goal_above_the_range_becomes_the_limit(wanted_deg, sent_deg, is_hit):
    limited = jaw_at(24.0).apply(np.array([wanted_deg]), PERIOD_S)

    assert limited.positions_deg[0] == sent_deg
    assert limited.range_hits[0] == is_hit
    assert not limited.rate_hits[0]


@pytest.mark.parametrize(
    ("wanted_deg", "is_hit"),
    [(-1.999999, False), (-2.0, False), (-2.0 - 1e-9, False), (-2.0 - 1e-5, True), (-90.0, True)],
)
def test_a_goal_below_the_range_becomes_the_limit(wanted_deg, is_hit):
    limited = jaw_at(-1.0).apply(np.array([wanted_deg]), PERIOD_S)

    assert limited.positions_deg[0] == max(wanted_deg, -2.0)
    assert limited.range_hits[0] == is_hit


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize(
    ("step_deg", "is_hit"),
    [(2.999999, False), (3.0, False), (3.0 + 1e-9, False), (3.0 + 1e-5, True), (9.0, True)],
)
def test_a_step_is_at_most_top_speed_times_the_tick(direction, step_deg, is_hit):
    limited = jaw_at(10.0).apply(np.array([10.0 + direction * step_deg]), PERIOD_S)

    assert abs(limited.positions_deg[0] - 10.0) == pytest.approx(min(step_deg, 3.0), abs=1e-9)
    assert limited.rate_hits[0] == is_hit
    assert not limited.range_hits[0]


@pytest.mark.parametrize(
    ("elapsed_s", "step_deg"),
    [(-1.0, 0.0), (0.0, 0.0), (0.005, 1.5), (0.01, 3.0), (0.011, 3.0), (0.02, 3.0), (60.0, 3.0)],
)
def test_a_stall_earns_the_step_of_one_tick_and_no_more(elapsed_s, step_deg):
    limited = jaw_at(10.0).apply(np.array([25.0]), elapsed_s)

    assert limited.positions_deg[0] == pytest.approx(10.0 + step_deg)


def test_the_step_counts_from_the_last_goal_sent_not_from_the_last_one_asked_for():
    limiter = jaw_at(0.0)
    limiter.apply(np.array([25.0]), PERIOD_S)
    limited = limiter.apply(np.array([25.0]), 2 * PERIOD_S)

    assert limited.positions_deg[0] == pytest.approx(6.0)


@pytest.mark.parametrize("invalid", [math.nan, math.inf, -math.inf])
def test_a_joint_without_a_finite_goal_stays_and_the_others_go_on(invalid):
    limiter = Limiter([JAW, LIP], PERIOD_S)
    limiter.start_from(np.array([10.0, 10.0]), 0.0)
    limited = limiter.apply(np.array([invalid, 11.0]), PERIOD_S)

    np.testing.assert_array_equal(limited.positions_deg, [10.0, 11.0])
    np.testing.assert_array_equal(limited.rejected, [True, False])


@pytest.mark.parametrize("shape", [(1,), (3,), (2, 2), ()])
def test_goals_of_the_wrong_shape_leave_every_joint_where_it_is(shape):
    limiter = Limiter([JAW, LIP], PERIOD_S)
    limiter.start_from(np.array([10.0, 10.0]), 0.0)
    limited = limiter.apply(np.zeros(shape), PERIOD_S)

    np.testing.assert_array_equal(limited.positions_deg, [10.0, 10.0])
    np.testing.assert_array_equal(limited.rejected, [True, True])


def test_a_joint_found_outside_its_range_is_led_back_at_its_own_speed():
    limiter = jaw_at(30.0)
    sent_deg = [limiter.apply(np.array([30.0]), n * PERIOD_S).positions_deg[0] for n in range(1, 4)]

    np.testing.assert_allclose(sent_deg, [27.0, 25.0, 25.0])


def test_hits_are_counted_by_kind_and_joint():
    limiter = Limiter([JAW, LIP], PERIOD_S)
    limiter.start_from(np.array([0.0, 0.0]), 0.0)
    limiter.apply(np.array([50.0, 1.0]), 1 * PERIOD_S)  # jaw: too far and too fast
    limiter.apply(np.array([math.nan, 30.0]), 2 * PERIOD_S)  # jaw: invalid; lip: too fast

    np.testing.assert_array_equal(limiter.counts.range_hits, [1, 0])
    np.testing.assert_array_equal(limiter.counts.rate_hits, [1, 1])
    np.testing.assert_array_equal(limiter.counts.rejected, [1, 0])


@pytest.mark.parametrize("start_deg", [np.array([math.nan]), np.array([0.0, 0.0])])
def test_the_gate_does_not_start_from_positions_that_are_invalid(start_deg):
    with pytest.raises(ValueError, match="one finite angle for each joint"):
        Limiter([JAW], PERIOD_S).start_from(start_deg, 0.0)


any_float = st.floats(allow_nan=True, allow_infinity=True)


@given(
    start_deg=st.tuples(st.floats(-2.0, 25.0), st.floats(-30.0, 40.0)),
    goals=st.lists(
        st.tuples(st.floats(0.0, 1.0), any_float | st.floats(-60, 60), any_float), max_size=40
    ),
)
def test_whatever_is_wanted_goals_stay_in_range_and_within_reach(start_deg, goals):
    limiter = Limiter([JAW, LIP], PERIOD_S)
    limiter.start_from(np.array(start_deg), 0.0)
    time_s, last_deg = 0.0, np.array(start_deg)
    for elapsed_s, *wanted_deg in goals:
        time_s += elapsed_s
        sent_deg = limiter.apply(np.array(wanted_deg), time_s).positions_deg

        assert np.all((sent_deg >= [-2.0, -30.0]) & (sent_deg <= [25.0, 40.0]))
        reach_deg = np.array([300.0, 400.0]) * min(elapsed_s, 2 * PERIOD_S)
        assert np.all(np.abs(sent_deg - last_deg) <= reach_deg + 1e-9)

        last_deg = sent_deg


@pytest.mark.parametrize(
    ("age_s", "level"),
    [
        (0.0, StaleLevel.FRESH),
        (0.1, StaleLevel.FRESH),
        (0.1001, StaleLevel.EASING),
        (0.9999, StaleLevel.EASING),
        (1.0, StaleLevel.NEUTRAL),
        (4.9999, StaleLevel.NEUTRAL),
        (5.0, StaleLevel.LIMP),
        (math.inf, StaleLevel.LIMP),
    ],
)
def test_silence_leads_from_holding_through_easing_and_neutral_to_limp(age_s, level):
    assert StaleRule().level(age_s) is level


@pytest.mark.parametrize(
    ("age_s", "weight"), [(0.0, 1.0), (0.1, 1.0), (0.55, 0.5), (1.0, 0.0), (9.0, 0.0)]
)
def test_the_held_position_fades_between_the_end_of_holding_and_neutral(age_s, weight):
    assert StaleRule().weight(age_s) == pytest.approx(weight)


@pytest.mark.parametrize("times_s", [(-0.1, 1.0, 5.0), (1.0, 1.0, 5.0), (0.1, 6.0, 5.0)])
def test_the_times_of_a_stale_rule_must_rise(times_s):
    with pytest.raises(ValueError, match="hold_s < neutral_s <= limp_s"):
        StaleRule(*times_s)


def test_easing_rises_smoothly_from_rest_to_rest():
    progress = np.linspace(0.0, 1.0, 1001)
    eased = np.array([ease(p) for p in progress])
    slope = np.gradient(eased, progress)

    assert (ease(-1.0), ease(0.0), ease(0.5), ease(1.0), ease(2.0)) == (0.0, 0.0, 0.5, 1.0, 1.0)
    assert np.all(np.diff(eased) > 0.0)
    assert slope.max() == pytest.approx(EASE_PEAK_SLOPE, abs=1e-3)
    np.testing.assert_allclose(slope[[0, -1]], 0.0, atol=0.01)


def test_a_joint_whose_turn_has_not_come_stays_and_then_is_slow_until_it_has_caught_up():
    limiter = Limiter(
        [Joint("jaw", 0, -30.0, 30.0, 300.0), Joint("lip", 1, -30.0, 30.0, 300.0)], 0.02
    )
    limiter.start_from(np.zeros(2), 0.0)
    limiter.hold_back(np.array([True, False]))
    sent = [limiter.apply(np.full(2, 12.0), 0.02 * n).positions_deg for n in range(1, 11)]
    np.testing.assert_allclose(sent[-1], [12.0, 0.0])

    limiter.hold_back(None)
    steps = np.diff(
        [limiter.apply(np.full(2, 12.0), 0.2 + 0.02 * n).positions_deg[1] for n in range(12)]
    )
    np.testing.assert_allclose(steps[1:9], 1.2)  # 60 deg/s
    limiter.apply(np.full(2, -12.0), 0.6)
    assert limiter.sent_deg[1] == pytest.approx(12.0 - 6.0)
