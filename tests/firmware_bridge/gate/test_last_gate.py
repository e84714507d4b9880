"""What no goal gets past, where one limit stands in the way of another."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from firmware_bridge.gate.limits import Limiter, Prevention, PreventRule
from firmware_bridge.joints import Joint

PERIOD_S = 0.01
SLOW = Joint("jaw", 1, -30.0, 30.0, 300.0, max_acceleration_deg_s2=6000.0)
QUICK = Joint("lip", 2, -30.0, 30.0, 300.0)
#: From rest, 6000 deg/s^2 make .6 deg in the first tick, and 1.2 more of speed a tick.
FIRST_STEP_DEG = 0.6


def started(*joints, prevent=(), at_deg=0.0):
    limiter = Limiter(joints, PERIOD_S, prevent)
    limiter.start_from(np.full(len(joints), at_deg), 0.0)
    return limiter


def test_joints_whose_rules_cannot_be_kept_by_shorter_steps_stay():
    """Cutting for either rule breaks the other again, each time by less: never by nothing."""
    prevention = Prevention(
        [PreventRule((1.0, -1.0, 0.0), 2.0, "?"), PreventRule((0.0, -1.0, 2.0), 10.0, "?")], 3
    )
    from_deg = np.array([-4.0, 0.0, 0.0])

    np.testing.assert_array_equal(prevention.cut(from_deg, np.array([8.0, 4.0, 8.0])), from_deg)


def test_a_cut_for_a_later_rule_that_breaks_an_earlier_one_is_followed_by_another():
    """The jaw stops at 4, so the lip, which may be 2 above it, cannot go to 8: half of both."""
    follows = PreventRule((-1.0, 1.0), 2.0, "the lip would leave the jaw")
    jaw_ends = PreventRule((1.0, 0.0), 4.0, "the jaw would touch the neck")
    prevention = Prevention([follows, jaw_ends], 2)
    sent = prevention.cut(np.zeros(2), np.array([8.0, 8.0]))

    assert sent[0] == pytest.approx(2.0)
    assert sent[1] == pytest.approx(4.0)


def test_a_rule_that_is_broken_already_holds_its_own_joints_and_no_others():
    prevention = Prevention([PreventRule((1.0, 1.0, 0.0), 30.0, "?")], 3)
    sent = prevention.cut(np.array([20.0, 20.0, 0.0]), np.array([21.0, 20.0, 10.0]))

    np.testing.assert_array_equal(sent, [20.0, 20.0, 10.0])


@pytest.mark.parametrize("above", [0.0, 5.0])
def test_a_rule_is_kept_to_its_last_degree_and_by_the_joints_of_the_rule_alone(above):
    prevention = Prevention([PreventRule((1.0, 1.0, 0.0), above, "?")], 3)
    sent = prevention.cut(np.zeros(3), np.array([10.0, 10.0, 10.0]))

    np.testing.assert_allclose(sent, [above / 2.0, above / 2.0, 10.0])


def test_a_step_that_keeps_all_rules_is_not_touched():
    prevention = Prevention([PreventRule((1.0, 1.0), 20.0, "?")], 2)
    wanted = np.array([10.0, 10.0])

    assert prevention.cut(np.zeros(2), wanted) is wanted


factor = st.sampled_from([-2.0, -1.0, 0.0, 1.0, 2.0])
place = st.floats(-20.0, 20.0)


@given(
    rules=st.lists(
        st.tuples(st.tuples(factor, factor, factor), st.floats(0.0, 10.0)), min_size=1, max_size=4
    ),
    from_deg=st.tuples(place, place, place),
    to_deg=st.tuples(place, place, place),
)
def test_whatever_the_rules_none_is_entered_further_than_it_was(rules, from_deg, to_deg):
    start = np.array(from_deg)
    sent = Prevention([PreventRule(*rule, "?") for rule in rules], 3).cut(start, np.array(to_deg))

    for factors, above in rules:
        assert np.dot(factors, sent) <= max(above, np.dot(factors, start)) + 1e-6


@pytest.mark.parametrize("factors", [(1.0,), (1.0, 1.0, 1.0)])
def test_a_rule_has_a_factor_for_each_joint(factors):
    with pytest.raises(ValueError, match="needs 2 factors"):
        Prevention([PreventRule(factors, 1.0, "?")], 2)


def test_a_goal_that_a_rule_cut_short_is_counted_as_that_and_as_nothing_else():
    limiter = started(QUICK, QUICK, prevent=[PreventRule((1.0, 0.0), 1.0, "?")])
    limited = limiter.apply(np.array([2.0, 2.0]), PERIOD_S)

    np.testing.assert_allclose(limited.positions_deg, [1.0, 2.0])
    np.testing.assert_array_equal(limited.prevented, [True, False])
    for other in (limited.range_hits, limited.rate_hits, limited.rejected):
        assert not other.any()
    np.testing.assert_array_equal(limiter.counts.prevented, [1, 0])
    limiter.apply(np.array([2.0, 2.0]), 2 * PERIOD_S)
    np.testing.assert_array_equal(limiter.counts.prevented, [2, 0])


def test_time_that_goes_back_earns_no_step_then_or_later():
    """Arming takes longer than the tick it happens in."""
    limiter = started(QUICK)
    assert limiter.apply(np.array([25.0]), 5 * PERIOD_S).positions_deg[0] == pytest.approx(3.0)
    assert limiter.apply(np.array([25.0]), 3 * PERIOD_S).positions_deg[0] == pytest.approx(3.0)
    assert limiter.apply(np.array([25.0]), 5 * PERIOD_S).positions_deg[0] == pytest.approx(3.0)
    assert limiter.apply(np.array([25.0]), 6 * PERIOD_S).positions_deg[0] == pytest.approx(6.0)


@pytest.mark.parametrize(("missed", "rests"), [(0, False), (1, False), (2, True), (100, True)])
def test_a_servo_that_stood_through_a_stall_starts_from_rest(missed, rests):
    """One late tick is no stall: the motion goes on. After two the servo stands at its goal."""
    limiter = started(SLOW, at_deg=-20.0)
    for n in range(1, 5):
        limiter.apply(np.array([20.0]), n * PERIOD_S)
    before_deg = limiter.sent_deg[0]
    sent_deg = limiter.apply(np.array([20.0]), (5 + missed) * PERIOD_S).positions_deg[0]

    assert sent_deg - before_deg == pytest.approx(FIRST_STEP_DEG if rests else 5 * FIRST_STEP_DEG)


@pytest.mark.parametrize("how", ["start_from", "start_one", "follow"])
def test_a_joint_that_is_started_anew_starts_from_rest(how):
    limiter = started(SLOW, SLOW)
    for n in range(1, 5):
        limiter.apply(np.array([20.0, 20.0]), n * PERIOD_S)
    at_deg = limiter.sent_deg.copy()
    if how == "start_from":
        limiter.start_from(at_deg, 4 * PERIOD_S)
    elif how == "start_one":
        limiter.start_one(1, float(at_deg[1]))
    else:
        limiter.follow(np.array([False, True]), at_deg)
        limiter.apply(at_deg, 4 * PERIOD_S)  # a limp joint stands in the tick after
    steps_deg = limiter.apply(np.array([20.0, 20.0]), 5 * PERIOD_S).positions_deg - at_deg

    assert steps_deg[1] == pytest.approx(FIRST_STEP_DEG)
    alone = FIRST_STEP_DEG if how == "start_from" else 3.0  # the top speed
    assert steps_deg[0] == pytest.approx(alone)


def test_a_limp_joint_counts_where_it_is_and_the_others_and_unknown_places_stay():
    limiter = started(QUICK, QUICK, QUICK)
    limiter.follow(np.array([True, True, False]), np.array([5.0, np.nan, 7.0]))

    np.testing.assert_array_equal(limiter.sent_deg, [5.0, 0.0, 0.0])


def test_one_joint_is_started_where_it_stands_and_what_was_handed_out_is_left_alone():
    limiter = started(QUICK, QUICK)
    before = limiter.sent_deg
    limiter.start_one(1, 4.0)

    np.testing.assert_array_equal(limiter.sent_deg, [0.0, 4.0])
    np.testing.assert_array_equal(before, [0.0, 0.0])
    for nowhere in (np.nan, np.inf, -np.inf):
        with pytest.raises(ValueError, match=r"start position .* is not finite"):
            limiter.start_one(1, nowhere)


def test_the_place_a_gate_was_started_from_is_its_own():
    place_deg = np.array([1.0])
    limiter = started(QUICK)
    limiter.start_from(place_deg, 0.0)
    place_deg[0] = 25.0

    assert limiter.sent_deg[0] == 1.0


def test_only_joints_with_a_limit_of_acceleration_are_slowed_by_it():
    limited = started(SLOW, QUICK).apply(np.array([2.0, 2.0]), PERIOD_S)

    np.testing.assert_allclose(limited.positions_deg, [FIRST_STEP_DEG, 2.0])
    np.testing.assert_array_equal(limited.rate_hits, [True, False])


def test_a_limp_joint_is_not_counted_as_slowed():
    limiter, at_deg = started(QUICK, QUICK), np.array([0.0, 4.0])
    for n in range(1, 4):
        limiter.follow(np.array([False, True]), at_deg)
        limited = limiter.apply(np.array([20.0, 20.0]), n * PERIOD_S)

    np.testing.assert_array_equal(limited.rate_hits, [True, False])
    np.testing.assert_array_equal(limiter.counts.rate_hits, [3, 0])
    assert limited.positions_deg[1] == 4.0


def test_nobody_is_slowed_in_the_moment_of_the_start():
    limited = started(SLOW, QUICK).apply(np.array([2.0, 2.0]), 0.0)

    np.testing.assert_array_equal(limited.positions_deg, [0.0, 0.0])
    assert not limited.rate_hits.any()


def test_a_tick_without_goals_sends_the_last_ones_and_hits_no_limit():
    limiter = started(QUICK)
    limiter.apply(np.array([25.0]), PERIOD_S)
    limited = limiter.unchanged()

    assert limited.positions_deg[0] == pytest.approx(3.0)
    for hits in (limited.range_hits, limited.rate_hits, limited.rejected, limited.prevented):
        assert not hits.any()
        assert not hits.flags.writeable


def test_a_joint_that_waits_is_not_moved_and_is_slow_only_until_it_has_caught_up():
    limiter = started(QUICK, QUICK)
    limiter.hold_back(np.array([True, False]))
    for n in range(1, 4):
        limiter.apply(np.array([1.0, 1.0]), n * PERIOD_S)
    np.testing.assert_allclose(limiter.sent_deg, [1.0, 0.0])

    limiter.hold_back(np.array([True, True]))
    steps = [limiter.apply(np.array([4.0, 1.0]), n * PERIOD_S).positions_deg for n in (4, 5, 6)]
    np.testing.assert_allclose(steps, [[4.0, 0.6], [4.0, 1.0], [4.0, 1.0]])
    assert limiter.apply(np.array([1.0, 4.0]), 7 * PERIOD_S).positions_deg[1] == pytest.approx(4.0)


def test_counts_that_were_handed_out_do_not_change():
    limiter = started(QUICK)
    before = limiter.counts
    limiter.apply(np.array([np.nan]), PERIOD_S)
    limiter.apply(np.array([90.0]), 2 * PERIOD_S)

    for counts in (before.range_hits, before.rate_hits, before.rejected, before.prevented):
        assert not counts.any()
    assert limiter.counts.rejected[0] == limiter.counts.range_hits[0] == 1
