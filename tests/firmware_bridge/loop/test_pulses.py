"""A face of hobby servos: what is done without a way back, and that nothing untrue is said."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from hobby_bus import PULSES, WORDS

from firmware_bridge.clock import ManualClock
from firmware_bridge.joints import Joint
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.face_table import FaceState
from firmware_bridge.loop.life_cycle import LifeCycle
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets
from firmware_bridge.simulator.bus import SimulatedBus
from firmware_bridge.stopping import StopLevel, StopReport

RATE_HZ = 50.0
JOINTS = [Joint("jaw", 0, -5.0, 25.0, 300.0), Joint("lip", 1, -10.0, 10.0, 300.0)]


@pytest.fixture
def face():
    clock, channel = ManualClock(), MemoryTargetChannel()
    bus = SimulatedBus(JOINTS, clock, capabilities=PULSES)
    bridge = Bridge(bus, JOINTS, channel, BridgeSettings(RATE_HZ))
    said = []
    return SimpleNamespace(
        clock=clock, channel=channel, bus=bus, bridge=bridge, said=said, sent=bus
    )


def drive(face, n, goal_deg=(12.0, -6.0)):
    for _ in range(n):
        time_s = face.clock.now() + 1.0 / RATE_HZ
        face.clock.sleep_until(time_s)
        face.channel.publish(ServoTargets(time_s, np.array(goal_deg)))
        face.bridge.tick(time_s)


def test_it_is_driven_to_its_goals_and_nobody_is_said_not_to_follow(face):
    with face.bus:
        face.bridge.start()
        drive(face, 200)
        drive(face, 200, (-4.0, 9.0))

        assert face.bridge.troubles == ()
        np.testing.assert_allclose(face.bus.history[-1].positions_deg, [-4.0, 9.0], atol=0.5)


def test_its_status_has_no_number_that_nobody_measured(face):
    with face.bus:
        face.bridge.start()
        drive(face, 5)
        told = face.bridge.as_dict()

    assert json.loads(json.dumps(told, allow_nan=False))["capabilities"]["place"] is False
    unknown = ("temperature_degc", "load", "voltage_v", "current_ma")
    assert {one[name] for one in told["health"] for name in unknown} == {None}
    assert {one["state"] for one in told["health"]} == {"driven"}


def test_a_stop_is_over_at_once_and_claims_nothing(face):
    with face.bus, LifeCycle(face.bridge, face.clock) as life:
        life.start()
        drive(face, 100)
        life.stop(StopLevel.LIMP)
        for time_s, late in life.ticks():
            face.bridge.tick(time_s, late)
    report = life.report

    assert (report.confirmed, report.released, report.unconfirmed) == ((), ("jaw", "lip"), {})
    assert report.complete
    assert WORDS in report.text()
    for text in (report.text(), report.line()):
        assert "limp" not in text
        assert "confirmed" not in text.replace("not confirmed", "")
    assert report.as_dict()["released_words"] == WORDS


def test_a_freeze_holds_the_goal_sent_last_and_a_start_goes_on_from_there(face):
    with face.bus:
        face.bridge.start()
        drive(face, 100)
        face.bridge.stop(StopLevel.FREEZE)
        drive(face, 50, (0.0, 0.0))
        np.testing.assert_allclose(face.bus.history[-1].goals_deg, [12.0, -6.0], atol=0.1)
        face.bridge.start()
        before = len(face.bus.history)
        drive(face, 100)
        goals_deg = np.stack([each.goals_deg for each in face.bus.history[before:]])

        assert face.bridge.state is FaceState.DRIVEN
        assert np.abs(goals_deg - [12.0, -6.0]).max() < 0.1


def test_one_servo_is_switched_off_without_waiting_for_its_word(face):
    with face.bus:
        face.bridge.start()
        drive(face, 20)
        from firmware_bridge.stopping import ServoOrder, ServoSwitch

        assert not face.bridge.obey(ServoOrder("jaw", ServoSwitch.OFF), face.clock.now())
        drive(face, 20)

        assert face.bridge.troubles == ("servo 'jaw' (id 0) switched off by a person",)
        assert face.bridge.as_dict()["servos"] == {"jaw": "off", "lip": "driven"}


def test_what_confirms_is_reported_as_before():
    report = StopReport(("jaw",), {}, at_rest=True)

    assert report.text() == "stopped; the face is at rest and limp: confirmed by 1 servo"
    assert list(report.as_dict()) == [
        "complete", "at_rest", "dry_run", "confirmed", "unconfirmed",
    ]  # fmt: skip
