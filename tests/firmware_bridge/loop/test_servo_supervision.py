"""Single servos under supervision: cooled, rebooted, enabled again, given up, spared."""

import numpy as np
import pytest

from firmware_bridge.bus import Feedback, Health, ServoState
from firmware_bridge.joints import Joint
from firmware_bridge.loop.servo_group import HeatDerating
from firmware_bridge.loop.servo_supervision import ServoSupervision


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
            "torque": np.ones(2, dtype=np.int8),
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
        self.values["torque"][index] = True
        return ""

    def disable(self, index):
        self.done.append(("disable", index))
        self.values["torque"][index] = False
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
    servos.values["torque"][1] = False
    servos.refusals[1] = "stopped by a person (limp)"
    servos.look(*np.arange(1.0, 10.0, 0.1))

    assert servos.done == []
    assert "lost its torque" in servos.supervision.reasons[1]

    servos.values["hardware_errors"][1] = 0x10
    servos.look(11.0)

    assert servos.done == []
    assert servos.supervision.reasons[1] == "electrical shock"


def test_answers_lost_one_by_one_after_late_ticks_accuse_no_servo():
    servos = SupervisedServos()
    for n in range(6):
        servos.values["silent_s"][1] = 0.6
        assert servos.look(float(n)) == ServoState.DRIVEN
        servos.values["silent_s"][1] = 0.0
        servos.look(n + 0.1, n + 0.2)


def test_a_silent_servo_gets_no_goals_until_it_answers():
    servos = SupervisedServos()
    servos.values["silent_s"][1] = 0.6
    assert servos.look(0.9) == ServoState.DRIVEN  # of one late tick it may be a single answer
    servos.look(0.95)
    assert servos.look(1.0) == ServoState.WAITING
    assert servos.look(5.0) == ServoState.WAITING
    servos.values["silent_s"][1] = 0.0
    assert servos.look(5.1) == ServoState.DRIVEN


def test_a_hot_servo_moves_less_and_then_not_at_all():
    servos = SupervisedServos()
    feedback = Feedback(0.0, np.zeros(2), np.zeros(2), np.zeros(2, np.uint8), np.zeros(2))
    servos.values["room_degc"][:] = [40.0, 5.0]
    heat = HeatDerating([True, True])
    np.testing.assert_allclose(heat.scale(feedback, Health(**servos.values)), [1.0, 0.5])
    servos.values["room_degc"][1] = 0.0
    assert servos.look(1.0) == ServoState.COOLING


def let_all_go(servos):
    servos.supervision.mark_all_waiting(1.5, "no motion comes from speech")


def restart(servos):
    servos.supervision.reboot(1, 1.5, servos)


def switch_off_and_on(servos):
    servos.supervision.switch_off(1, 1.5)
    servos.look(1.6, 1.7)
    servos.supervision.switch_on(1, 1.8)


@pytest.mark.parametrize("meanwhile", [None, let_all_go, restart, switch_off_and_on])
def test_a_servo_that_was_too_hot_is_limp_until_it_has_cooled_down_whatever_is_done(meanwhile):
    servos = SupervisedServos()
    servos.values["room_degc"][1] = 0.0
    servos.look(1.0)
    servos.values["room_degc"][1] = 2.0
    if meanwhile is not None:
        meanwhile(servos)
    servos.look(*np.arange(2.0, 10.0, 0.1))
    assert ("enable", 1) not in servos.done
    assert servos.supervision.reasons[1] == "too hot"
    servos.values["room_degc"][1] = 5.0
    assert servos.look(*np.arange(10.0, 12.0, 0.1)) == ServoState.DRIVEN
    assert servos.supervision.reasons[1] == ""


@pytest.mark.parametrize("room_degc", [2.0, np.nan, np.inf])
def test_a_servo_that_is_warm_or_does_not_know_gets_torque_as_long_as_it_was_not_too_hot(room_degc):
    servos = SupervisedServos()
    servos.values["room_degc"][1] = room_degc
    servos.supervision.mark_all_waiting(0.5)
    assert servos.look(*np.arange(1.0, 3.0, 0.1)) == ServoState.DRIVEN


def test_a_joint_that_works_hard_for_minutes_moves_less():
    servos, heat = SupervisedServos(), HeatDerating([True, True])
    effort = np.array([0.2, 0.8])
    for tick in range(6000):
        feedback = Feedback(tick * 0.03, np.zeros(2), effort, np.zeros(2, np.uint8), np.zeros(2))
        scale = heat.scale(feedback, Health(**servos.values))

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
    assert "given up until a start" in servos.supervision.reasons[1]


def test_a_servo_given_up_and_switched_on_by_a_person_has_all_its_tries_again():
    servos = SupervisedServos()

    def fail_until(end_s, from_s):
        for round_s in range(from_s, end_s, 10):
            servos.values["hardware_errors"][1] = 0x20
            servos.look(*np.arange(round_s, round_s + 9, 0.5))
        return [act for act, _ in servos.done].count("reboot")

    assert fail_until(100, 0) == 3
    assert servos.supervision.states[1] == ServoState.FAILED
    servos.refusals[1] = ""
    assert servos.supervision.switch_on(1, 100.0)
    assert fail_until(300, 100) == 6
    assert servos.supervision.states[1] == ServoState.FAILED
    assert not servos.supervision.switch_on(0, 300.0)  # it is driven anyway


def test_whom_a_person_switched_off_is_let_go_again_and_again_until_it_confirms():
    servos = SupervisedServos()
    confirms = [False, False, False, True]

    def disable(index):
        servos.done.append(("disable", index))
        servos.values["torque"][index] = not confirms[0]
        return confirms.pop(0)

    servos.disable = disable
    servos.supervision.switch_off(1, 1.0)
    states = [servos.look(time_s) for time_s in np.arange(1.0, 5.0, 0.1)]

    assert servos.done == [("disable", 1)] * 4
    assert states[:15] == [ServoState.SWITCHING_OFF] * 15
    assert states[-1] == ServoState.OFF
    assert servos.supervision.reasons[1] == "switched off by a person"
    servos.values["hardware_errors"][1] = 0x20  # nothing is done about it
    assert servos.look(*np.arange(6.0, 20.0, 0.5)) == ServoState.OFF
