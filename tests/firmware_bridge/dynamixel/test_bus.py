"""A face of Dynamixel servos as one bus: goals and places, whatever happens on the wire."""

import random

import numpy as np
import pytest
from dynamixel_chain import BAUD_RATE, MemoryFace, enable_all, mounted, run
from lipservo_lab.campaigns.line_campaign import Disturbance, DisturbedTransport

from firmware_bridge.clock import ManualClock
from firmware_bridge.dynamixel.bus import DynamixelBus
from firmware_bridge.dynamixel.wire.codec import StatusError
from firmware_bridge.errors import PortError, PortGone
from firmware_bridge.simulator.chain import chain_for
from firmware_bridge.simulator.faults import Fault


def test_goals_in_joint_degrees_arrive_whatever_sign_and_offset():
    face = MemoryFace(4)
    with face.bus:
        enable_all(face)
        run(face, 1.5, [10.0, -20.0, 30.0, 0.5])
        readings = face.bus.read()

    np.testing.assert_allclose(readings.positions_deg, [10.0, -20.0, 30.0, 0.5], atol=0.2)
    np.testing.assert_allclose(readings.goals_deg, [10.0, -20.0, 30.0, 0.5], atol=0.05)
    assert (readings.torque == 1).all()
    assert not readings.errors.any()
    assert not readings.missing.any()
    assert face.chain.counts.contention == 0


def test_models_may_be_mixed_on_one_line():
    servos = mounted(1) + mounted(3, "XM430-W350")[1:2] + mounted(3, "XL430-W250")[2:]
    face = MemoryFace(servos=servos)
    with face.bus:
        enable_all(face)
        run(face, 1.5, [10.0, 10.0, 10.0])

        np.testing.assert_allclose(face.bus.read().positions_deg, 10.0, atol=0.2)


@pytest.mark.parametrize("chain_stops", [False, True])
@pytest.mark.parametrize("silent", [0, 2, 4])
def test_a_silent_servo_costs_only_itself(silent, chain_stops):
    """Whether servos behind a silent one answer is not known of real ones: both ways hold."""
    from firmware_bridge.simulator.wire import WireRules

    fault = Fault("silence", servos=(silent,), at_s=(0.5,))
    face = MemoryFace(5, faults=[fault], rules=WireRules(chain_stops=chain_stops))
    with face.bus:
        enable_all(face)
        run(face, 0.6, np.zeros(5))
        heard = run(face, 2.0, np.zeros(5))
        ages = np.array([feedback.age_s for feedback in heard])

    others = np.delete(ages, silent, axis=1)
    assert np.mean(others == 0.0) > 0.97
    assert ages[-1, silent] == pytest.approx(2.1, abs=0.2)
    assert face.chain.counts.contention == 0


def test_a_servo_that_comes_back_is_heard_again():
    face = MemoryFace(5, faults=[Fault("silence", servos=(1,), at_s=(0.5,), lasts_s=1.0)])
    with face.bus:
        run(face, 3.0, np.zeros(5))

        assert not face.bus.feedback().age_s.any()


def test_lost_packets_are_asked_for_again_without_a_collision():
    face = MemoryFace(10, faults=[Fault("drop_reply", probability=0.05)], seed=4)
    with face.bus:
        heard = run(face, 4.0, np.zeros(10))

    obtained = np.mean([feedback.age_s == 0.0 for feedback in heard])
    assert obtained > 0.99  # lost ones are asked again in the same cycle
    assert face.chain.counts.contention == 0


def test_damaged_packets_never_become_positions():
    face = MemoryFace(10, faults=[Fault("corrupt_reply", probability=0.2, from_s=0.5)], seed=5)
    with face.bus:
        heard = run(face, 3.0, np.zeros(10))
        places = np.array([feedback.positions_deg for feedback in heard])

    assert np.nanmax(np.abs(places)) < 0.1


@pytest.mark.parametrize("goal_deg", [50.0, np.nan, np.inf, -1e12])
def test_a_goal_that_a_servo_would_refuse_is_not_sent_and_says_so(goal_deg):
    face = MemoryFace(2)
    with face.bus:
        enable_all(face)
        run(face, 1.0, [10.0, 10.0])
        face.bus.write_positions(np.array([goal_deg, 12.0]))
        readings = face.bus.read()

    np.testing.assert_allclose(readings.goals_deg, [10.0, 12.0], atol=0.05)
    np.testing.assert_array_equal(readings.errors, [StatusError.DATA_LIMIT, 0])


def test_an_unplugged_port_is_gone_until_reopened():
    face = MemoryFace(3, faults=[Fault("unplug", at_s=(1.0,), lasts_s=2.0)])
    with face.bus:
        enable_all(face)
        face.clock.sleep_until(1.5)
        with pytest.raises(PortGone):
            face.bus.feedback()
        with pytest.raises(PortError):
            face.bus.reopen()
        with pytest.raises(PortError):
            face.bus.feedback()
        face.clock.sleep_until(3.5)
        face.bus.reopen()

        assert not face.bus.feedback().age_s.any()


def test_voltage_and_warmth_are_heard_in_turns():
    face = MemoryFace(3)
    with face.bus:
        run(face, 0.2, np.zeros(3))
        health = face.bus.look_after()

    np.testing.assert_allclose(health.voltage_v, 5.0, atol=0.11)
    np.testing.assert_allclose(health.room_degc, 45.0)


def test_a_goal_that_was_not_read_back_does_not_count_as_verified():
    face = MemoryFace(2, faults=[Fault("silence", servos=(1,), at_s=(1.0,))])
    with face.bus:
        face.clock.sleep_until(1.5)
        face.bus.write_positions(np.zeros(2))

        assert np.isnan(face.bus.read().goals_deg).tolist() == [False, True]


def test_a_slow_adapter_is_remarked_once_its_port_is_open():
    face = MemoryFace(2)
    bus = DynamixelBus(face.servos, face.open, adapter_remark=lambda: "too slow")

    assert bus.remarks() == ()
    with bus:
        assert bus.remarks() == ("too slow",)


def test_servos_that_do_not_know_fast_reads_are_remarked():
    clock = ManualClock()
    servos = mounted(3)
    chain = chain_for(servos, BAUD_RATE)
    with DynamixelBus(
        servos,
        lambda: DisturbedTransport(
            chain, clock, random.Random(0), Disturbance(fast_sync_read=False)
        ),
    ) as bus:
        assert bus.remarks() == ()
        for _ in range(10):
            bus.feedback()
        assert ["Fast Sync Read" in each for each in bus.remarks()] == [True]
