"""A person finds the limits of a hobby servo: a little beyond them, slowly; told by its pulses."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from driven_robot import Robot
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_bridge.clock import ManualClock
from firmware_bridge.joints import Joint, JointPulse
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.face_table import FaceState
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets
from firmware_bridge.maestro.kind import MAESTRO
from firmware_bridge.pulse_bus import PulseBus
from firmware_bridge.pulse_servos import PulseServo
from firmware_bridge.stopping import ArmJog, EndJog, JogPulse, JogTo, StopLevel

RATE_HZ = 50.0
#: 1500 us is neutral, 10 us a degree, 1400 to 1600 us as `new-face` writes it.
JAW = {"channel": 0, "positive": "opens", "min_deg": -10.0, "max_deg": 10.0, "us_per_deg": 10.0}
BEYOND_US_S = 50.0


class Pulses:
    """A controller in memory: every pulse that it was told, (n_servos,) a row."""

    def __init__(self):
        self.sent = []

    def open(self):
        pass

    def close(self):
        pass

    def send(self, pulses_us):
        self.sent.append(np.array(pulses_us))
        return True

    is_blocked = False

    def sending(self, index):
        return float(self.sent[-1][index]) if self.sent else float("nan")

    def remarks(self):
        return ()


def made(**jaw):
    servos = [
        PulseServo(**{**JAW, "max_speed_deg_s": 300.0, "min_us": 1400.0, "max_us": 1600.0} | jaw),
        PulseServo(**{**JAW, "channel": 1, "max_speed_deg_s": 300.0}),
    ]
    joints = [
        Joint(name, each.channel, each.min_deg, each.max_deg, 300.0, pulse=each.pulse)
        for name, each in zip(("jaw", "lip"), servos, strict=True)
    ]
    clock, channel, controller = ManualClock(), MemoryTargetChannel(), Pulses()
    can = MAESTRO.capabilities(MAESTRO.settings(model="micro6", port="/dev/ttyACM0"))
    bus = PulseBus(servos, controller, clock, can, may_jump=True)
    bridge = Bridge(bus, joints, channel, BridgeSettings(RATE_HZ))
    return SimpleNamespace(
        clock=clock, channel=channel, bus=bus, bridge=bridge, controller=controller
    )


def drive(face, seconds, goal_deg=0.0, order=None):
    """Speech wants an angle of both; an order is given again in every tick."""
    refusals = []
    for _ in range(round(seconds * RATE_HZ)):
        time_s = face.clock.now() + 1.0 / RATE_HZ
        face.clock.sleep_until(time_s)
        face.channel.publish(ServoTargets(time_s, np.full(2, goal_deg)))
        if order is not None:
            refusals.append(face.bridge.obey(order, time_s))
        face.bridge.tick(time_s)
    return refusals


def jaw_us(face, since=0):
    return np.array([row[0] for row in face.controller.sent[since:]])


@pytest.fixture
def face():
    found = made()
    with found.bus:
        found.bridge.start()
        drive(found, 2.0)
        yield found


def lead(face, *pulses_us):
    """The jaw to these, one after the other, each reached."""
    for pulse_us in pulses_us:
        assert face.bridge.obey(ArmJog(), face.clock.now()) == ""
        assert face.bridge.obey(JogPulse("jaw", pulse_us), face.clock.now()) == ""
        drive(face, 2.5)


def test_it_goes_beyond_its_limits_step_by_step_and_slowly(face):
    lead(face, 1600.0)
    before = len(face.controller.sent)

    lead(face, 1610.0, 1620.0, 1630.0)

    way_us = jaw_us(face, before)
    assert way_us[-1] == pytest.approx(1630.0)
    assert np.abs(np.diff(way_us)).max() <= BEYOND_US_S / RATE_HZ + 1e-6
    assert face.bridge.as_dict()["pulses"]["jaw"]["sent_us"] == pytest.approx(1630.0)
    assert not any(row[1] != 1500.0 for row in face.controller.sent[before:]), "the lip stays"


def test_after_the_last_word_it_goes_back_within_its_limits_and_speech_keeps_to_them(face):
    lead(face, 1600.0, 1610.0, 1620.0)
    before = len(face.controller.sent)
    drive(face, 8.0, goal_deg=90.0)

    back_us = jaw_us(face, before)
    assert back_us[-1] == pytest.approx(1600.0), "its limit, whatever speech wants"
    assert back_us.max() <= 1620.0 + 1e-6, "never farther out"
    assert np.abs(np.diff(back_us)).max() <= 300.0 / RATE_HZ + 1e-6


@pytest.mark.parametrize(
    ("order", "words"),
    [
        (JogPulse("jaw", 1625.0), "beyond its limits, 1400 to 1600 us, it goes 10 us at a time"),
        (JogPulse("jaw", 1380.0), "it is at 1500"),
        (JogPulse("jaw", 499.0), "never outside 500 to 2500"),
        (JogPulse("jaw", 2501.0), "never outside 500 to 2500"),
        (JogPulse("jaw", float("nan")), "never outside 500 to 2500"),
        (JogPulse("tongue", 1500.0), "no such servo; there are: jaw, lip"),
        (JogTo("jaw", 11.0), "allowed: -10 to 10 deg"),
    ],
)
def test_a_jump_is_refused_and_nothing_moves(face, order, words):
    before = len(face.controller.sent)
    face.bridge.obey(ArmJog(), face.clock.now())

    assert words in face.bridge.obey(order, face.clock.now())
    drive(face, 0.5)

    assert set(jaw_us(face, before)) == {1500.0}


def test_it_needs_the_arming_switch(face):
    assert "not armed" in face.bridge.obey(JogPulse("jaw", 1510.0), face.clock.now())


def test_a_servo_without_pulses_is_jogged_in_degrees():
    robot = Robot(stops=[(3.0, "soft")])
    answers = []
    words = {1.0: "jog arm", 1.1: "jog joint_1 1500 us"}
    robot.live(
        10.0, {at: lambda w=word: answers.append(robot.say(w)) for at, word in words.items()}
    )

    assert answers[1] == {"error": "servo 'joint_1' (id 1) takes no pulses: jog it in degrees"}


@pytest.mark.parametrize("level", [StopLevel.SOFT, StopLevel.LIMP, StopLevel.FREEZE])
def test_a_stop_beyond_the_limits_is_a_stop(face, level):
    lead(face, 1600.0, 1610.0, 1620.0)
    before = len(face.controller.sent)
    face.bridge.stop(level)
    drive(face, 3.0)

    way_us = jaw_us(face, before)
    if level is StopLevel.FREEZE:
        assert set(way_us) == {1620.0}
        face.bridge.start()
        drive(face, 4.0)
        assert jaw_us(face)[-1] == pytest.approx(1500.0)
        return
    assert face.bridge.state is FaceState.ENDED
    assert way_us[-1] == 0.0
    if level is StopLevel.SOFT:
        eased_us = way_us[way_us > 0.0]
        assert eased_us[-1] == pytest.approx(1500.0, abs=1.0)
        assert np.abs(np.diff(eased_us)).max() <= 300.0 * 10.0 / RATE_HZ + 1e-6


@given(
    st.lists(st.tuples(st.floats(0.02, 0.6), st.floats(300.0, 2700.0)), max_size=12),
    st.sampled_from([10.0, -11.1]),
)
@settings(max_examples=25, deadline=None)
def test_whatever_is_ordered_no_pulse_jumps_and_none_leaves_500_to_2500(orders, us_per_deg):
    face = made(us_per_deg=us_per_deg, min_us=1389.0, max_us=1611.0)
    with face.bus:
        face.bridge.start()
        drive(face, 1.5)
        before = len(face.controller.sent)
        for seconds, pulse_us in orders:
            face.bridge.obey(ArmJog(), face.clock.now())
            near_us = face.bridge.as_dict()["pulses"]["jaw"]["sent_us"]
            for each_us in (pulse_us, near_us + 9.0 * np.sign(pulse_us - near_us)):
                face.bridge.obey(JogPulse("jaw", float(each_us)), face.clock.now())
            drive(face, seconds)
        face.bridge.obey(EndJog(), face.clock.now())
        drive(face, 12.0)
        way_us = jaw_us(face, before)

    assert way_us.min() >= 500.0
    assert way_us.max() <= 2500.0
    assert np.abs(np.diff(way_us)).max(initial=0.0) <= 30.0 * abs(us_per_deg) / RATE_HZ + 1e-6
    assert way_us[-1] == pytest.approx(1500.0)


def test_a_pulse_and_its_angle_are_the_same_either_way():
    pulse = JointPulse(1500.0, -11.1, 1300.0, 1800.0)

    assert pulse.us(10.0) == pytest.approx(1389.0)
    assert pulse.deg(pulse.us(7.5)) == pytest.approx(7.5)
    assert pulse.reach_us == (500.0, 2500.0)
    assert pulse.reach_deg == pytest.approx((-1000 / 11.1, 1000 / 11.1))
    assert replace(pulse, min_us=450.0).reach_us == (450.0, 2500.0)
