"""The gate's newer powers: acceleration, rules between joints, supervision of single servos."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_bridge.gate.braking import braking_speed
from firmware_bridge.gate.coupling import Prevention, PreventRule
from firmware_bridge.gate.limits import Limiter
from firmware_bridge.gate.tracking import TrackingMonitor, TrackingRule
from firmware_bridge.health import Feedback, Health
from firmware_bridge.joints import Joint
from firmware_bridge.loop.servo_supervision import ServoState, ServoSupervision

PERIOD_S = 0.01
JOINT = Joint("jaw", 1, -10.0, 20.0, 300.0, max_acceleration_deg_s2=6000.0)

ONE_JOINT = [Joint("jaw", 1, -40.0, 40.0, 300.0)]


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
    with pytest.raises(ValueError, match="does not fit"):
        Prevention([PreventRule((1.0, 0.0), -1.0, "?")], 2)


class SupervisedServos:
    """Two servos as supervision sees them, and what it did to them."""

    def __init__(self):
        self.supervision = ServoSupervision(
            [Joint(f"j{n}", n, -10.0, 10.0, 100.0) for n in range(2)]
        )
        for n in range(2):
            self.supervision.note_attempt(n, "", time_s=0.0)
        self.done = []
        self.refusals = ["", ""]
        self.values = {
            "silent_s": np.zeros(2),
            "torque_on": np.ones(2, dtype=bool),
            "watchdog_tripped": np.zeros(2, dtype=bool),
            "hardware_errors": np.zeros(2, dtype=np.uint8),
            "temperature_degc": np.full(2, 30.0),
            "room_degc": np.full(2, 40.0),
            "voltage_v": np.full(2, 5.0),
            "effort": np.zeros(2),
            "current_ma": np.zeros(2),
            "n_unanswered": np.zeros(2, dtype=np.int64),
        }

    def refusal(self, index):
        return self.refusals[index]

    def enable(self, index):
        self.done.append(("enable", index))
        self.values["torque_on"][index] = True
        return ""

    def disable(self, index):
        self.done.append(("disable", index))
        self.values["torque_on"][index] = False
        return True

    def give_up(self, index, because):
        self.refusals[index] = because

    def reboot(self, index):
        self.done.append(("reboot", index))
        self.values["hardware_errors"][index] = 0

    def look(self, *times_s):
        for time_s in times_s:
            self.supervision.act(Health(**self.values), time_s, self)
        return self.supervision.states[1]


def test_a_servo_with_an_error_is_let_go_cooled_rebooted_and_enabled():
    servos = SupervisedServos()
    servos.values["hardware_errors"][1] = 0x20
    assert servos.look(1.0) == ServoState.COOLING
    assert servos.look(1.5) == ServoState.COOLING
    assert servos.look(2.1) == ServoState.REBOOTING
    assert servos.look(3.2) == ServoState.DRIVEN

    assert servos.done == [("disable", 1), ("reboot", 1), ("enable", 1)]
    assert servos.supervision.driven.tolist() == [True, True]


def test_reboots_are_bounded_and_then_the_servo_stays_limp():
    servos = SupervisedServos()
    for round_s in range(0, 100, 10):
        servos.values["hardware_errors"][1] = 0x20
        servos.look(*np.arange(round_s, round_s + 9, 0.5))

    assert servos.supervision.states.tolist() == [ServoState.DRIVEN, ServoState.FAILED]
    assert [act for act, _ in servos.done].count("reboot") == 3


def test_a_servo_that_does_not_confirm_its_torque_off_is_told_again():
    servos = SupervisedServos()
    servos.disable = lambda index: servos.done.append(("disable", index))  # nothing comes of it
    servos.values["hardware_errors"][1] = 0x20
    servos.look(*np.arange(1.0, 10.0, 0.1))

    assert [act for act, _ in servos.done].count("disable") > 10
    assert ("reboot", 1) not in servos.done


def test_nobody_gets_torque_whom_the_gate_refuses():
    servos = SupervisedServos()
    servos.values["torque_on"][1] = False
    servos.refusals[1] = "stopped by a person (limp)"
    servos.look(*np.arange(1.0, 10.0, 0.1))

    assert servos.done == []
    assert "lost its torque" in servos.supervision.reasons[1]

    servos.values["hardware_errors"][1] = 0x10
    servos.look(11.0)

    assert servos.done == []
    assert servos.supervision.reasons[1] == "electrical shock"


def test_a_silent_servo_gets_no_goals_until_it_answers():
    servos = SupervisedServos()
    servos.values["silent_s"][1] = 0.6
    assert servos.look(1.0) == ServoState.WAITING
    assert servos.look(5.0) == ServoState.WAITING
    servos.values["silent_s"][1] = 0.0
    assert servos.look(5.1) == ServoState.DRIVEN


def test_a_hot_servo_moves_less_and_then_not_at_all():
    servos = SupervisedServos()
    feedback = Feedback(0.0, np.zeros(2), np.zeros(2), np.zeros(2, np.uint8), np.zeros(2))
    servos.values["room_degc"][:] = [40.0, 5.0]
    np.testing.assert_allclose(
        servos.supervision.scale(feedback, Health(**servos.values)), [1.0, 0.5]
    )
    servos.values["room_degc"][1] = 0.0
    assert servos.look(1.0) == ServoState.COOLING


def test_a_joint_that_works_hard_for_minutes_moves_less():
    servos = SupervisedServos()
    effort = np.array([0.2, 0.8])
    for tick in range(6000):
        feedback = Feedback(tick * 0.03, np.zeros(2), effort, np.zeros(2, np.uint8), np.zeros(2))
        scale = servos.supervision.scale(feedback, Health(**servos.values))

    assert scale[0] == 1.0
    assert scale[1] == pytest.approx(0.3)


def test_a_servo_that_does_not_follow_is_let_go_tried_again_and_given_up():
    servos = SupervisedServos()
    for tick in range(3000):
        time_s = tick * 0.02
        stands = np.array([5.0, -20.0])  # the second is jammed far from its goal
        feedback = Feedback(time_s, stands, np.zeros(2), np.zeros(2, np.uint8), np.zeros(2))
        servos.supervision.check_tracking(np.array([5.0, 10.0]), feedback)
        servos.look(time_s)

    assert servos.supervision.states.tolist() == [ServoState.DRIVEN, ServoState.FAILED]
    assert [act for act, _ in servos.done].count("enable") == 3
    assert servos.supervision.reasons[0] == ""
    assert "does not follow, 30 deg off for 0.5 s" in servos.supervision.reasons[1]
    assert "it stays limp" in servos.supervision.reasons[1]


@pytest.mark.parametrize(
    ("lag_deg", "age_s", "behind"), [(14.9, 0.0, False), (15.1, 0.0, True), (90.0, 1.0, False)]
)
def test_only_a_lasting_error_that_was_heard_counts(lag_deg, age_s, behind):
    monitor = TrackingMonitor(ONE_JOINT, TrackingRule(error_deg=15.0, after_s=0.5))
    found = []
    for tick in range(60):
        age = np.array([age_s])
        feedback = Feedback(tick * 0.01, np.zeros(1), np.zeros(1), np.zeros(1, np.uint8), age)
        found.append(bool(monitor.behind(np.array([lag_deg]), feedback)[0]))

    assert found == [behind and tick > 50 for tick in range(60)]


def test_quick_motion_that_crosses_its_goal_is_no_failure_to_follow():
    """25 deg to and fro, always 30 ms late: up to 20 deg behind, but never for half a second."""
    monitor = TrackingMonitor(ONE_JOINT, TrackingRule())
    for tick in range(1000):
        time_s = tick * 0.01
        goal, place = (25.0 * np.sin(2 * np.pi * 4.0 * s) for s in (time_s, time_s - 0.03))
        heard = Feedback(time_s, np.array([place]), np.zeros(1), np.zeros(1, np.uint8), np.zeros(1))
        assert not monitor.behind(np.array([goal]), heard).any()
