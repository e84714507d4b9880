import random

import numpy as np
import pytest
from disturbed_transport import DisturbedTransport
from dynamixel_chain import BAUD_RATE, MemoryFace, mounted

from firmware_bridge.bus import PortError, PortGone, ServoError
from firmware_bridge.clock import ManualClock
from firmware_bridge.dynamixel.bus import DynamixelBus
from firmware_bridge.dynamixel.mounting import MountedServo
from firmware_bridge.dynamixel.wire.codec import StatusError
from firmware_bridge.simulator.face import chain_for
from firmware_bridge.simulator.faults import Fault


def run(face, seconds, goal_deg, rate_hz=100.0):
    """Write the same goal and listen for a while; the feedback of every tick."""
    heard = []
    end_s = face.clock.now() + seconds
    while face.clock.now() < end_s:
        tick_s = face.clock.now() + 1.0 / rate_hz
        face.bus.write_positions(np.asarray(goal_deg, dtype=float))
        heard.append(face.bus.feedback())
        face.bus.look_after()
        face.clock.sleep_until(tick_s)
    return heard


def awake(face):
    for index in range(len(face.servos)):
        assert face.bus.enable_torque(index) == ""


def test_goals_in_joint_degrees_arrive_whatever_sign_and_offset():
    face = MemoryFace(4)
    with face.bus:
        awake(face)
        run(face, 1.5, [10.0, -20.0, 30.0, 0.5])
        readings = face.bus.read()

    np.testing.assert_allclose(readings.positions_deg, [10.0, -20.0, 30.0, 0.5], atol=0.2)
    np.testing.assert_allclose(readings.goals_deg, [10.0, -20.0, 30.0, 0.5], atol=0.05)
    assert readings.torque_on.all()
    assert not readings.errors.any()
    assert not readings.missing.any()
    assert face.chain.counts.contention == 0


def test_models_may_be_mixed_on_one_line():
    servos = mounted(1) + mounted(3, "XM430-W350")[1:2] + mounted(3, "XL430-W250")[2:]
    face = MemoryFace(servos=servos)
    with face.bus:
        awake(face)
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
        awake(face)
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
        heard = run(face, 10.0, np.zeros(10))

    obtained = np.mean([feedback.age_s == 0.0 for feedback in heard])
    assert obtained > 0.99  # lost ones are asked again in the same cycle
    assert face.chain.counts.contention == 0


def test_damaged_packets_never_become_positions():
    face = MemoryFace(10, faults=[Fault("corrupt_reply", probability=0.2, from_s=0.5)], seed=5)
    with face.bus:
        heard = run(face, 5.0, np.zeros(10))
        places = np.array([feedback.positions_deg for feedback in heard])

    assert np.nanmax(np.abs(places)) < 0.1


@pytest.mark.parametrize("goal_deg", [50.0, np.nan, np.inf, -1e12])
def test_a_goal_that_a_servo_would_refuse_is_not_sent_and_says_so(goal_deg):
    face = MemoryFace(2)
    with face.bus:
        awake(face)
        run(face, 1.0, [10.0, 10.0])
        face.bus.write_positions(np.array([goal_deg, 12.0]))
        readings = face.bus.read()

    np.testing.assert_allclose(readings.goals_deg, [10.0, 12.0], atol=0.05)
    np.testing.assert_array_equal(readings.errors, [StatusError.DATA_LIMIT, 0])


def test_torque_off_reaches_everybody_although_packets_are_lost():
    face = MemoryFace(5, faults=[Fault("drop_instruction", probability=0.3, from_s=1.0)], seed=6)
    with face.bus:
        awake(face)
        face.clock.sleep_until(1.0)
        assert face.bus.disable_all().all()

    assert not any(servo.torque_on for servo in face.chain.servos)


def test_leaving_switches_torque_off_even_after_an_exception():
    face = MemoryFace(3)

    def fail():
        with face.bus:
            awake(face)
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()

    assert not any(servo.torque_on for servo in face.chain.servos)


def test_the_servos_stop_by_themselves_when_we_fall_silent_and_go_on_when_we_return():
    face = MemoryFace(2)
    with face.bus:
        awake(face)
        run(face, 1.5, [30.0, 30.0])
        face.bus.write_positions(np.array([-30.0, -30.0]))
        face.clock.advance(5.0)
        stopped = face.bus.feedback().positions_deg
        assert (stopped > -29.0).all()
        assert all(servo["bus_watchdog"] == -1 for servo in face.chain.servos)
        run(face, 1.0, [-30.0, -30.0])

        np.testing.assert_allclose(face.bus.read().positions_deg, -30.0, atol=0.2)


def test_the_watchdog_is_set_before_torque_and_torque_before_any_other_goal():
    face = MemoryFace(1)
    with face.bus:
        face.written.clear()
        assert face.bus.enable_torque(0) == ""
    registers = [data[8] for _, data in face.written if data[7] == 3]

    assert registers.index(112 - 4) < registers.index(64)  # profile, from acceleration on
    assert registers.index(98) < registers.index(64)
    assert registers.index(116) < registers.index(64)


def test_waking_moves_nothing_whatever_goal_the_servo_remembers():
    face = MemoryFace(1)
    face.chain.servos[0]["goal_position"] = 2300
    with face.bus:
        before = face.bus.read().positions_deg
        assert face.bus.enable_torque(0) == ""
        face.clock.advance(0.05)

        np.testing.assert_allclose(face.bus.read().positions_deg, before, atol=0.1)


def test_an_unplugged_port_is_gone_until_reopened():
    face = MemoryFace(3, faults=[Fault("unplug", at_s=(1.0,), lasts_s=2.0)])
    with face.bus:
        awake(face)
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


def test_every_mismatch_of_the_servos_is_in_one_error():
    servos = mounted(3)
    face = MemoryFace(servos=servos)
    face.chain.servos[0]["id"] = 77
    face.chain.servos[1]["max_position_limit"] = 2100
    face.chain.servos[2]["operating_mode"] = 3
    face.chain.servos[2]["model_number"] = 1190
    with pytest.raises(ServoError) as error, face.bus:
        pass
    lines = str(error.value).splitlines()

    assert "'joint_1' (id 1) does not answer" in lines[0]
    assert "'joint_2' (id 2) has limits" in lines[1]
    assert "is not the XL330-M288 of the YAML but an XL330-M077" in lines[2]


def test_a_running_face_is_not_stopped_by_a_missing_servo_unless_it_is_critical():
    face = MemoryFace(3, strict=False)
    face.chain.servos[0]["id"] = 77
    with face.bus:
        assert face.bus.feedback().age_s[0] > 0.0

    face = MemoryFace(servos=mounted(3, critical=True), strict=False)
    face.chain.servos[0]["id"] = 77
    with pytest.raises(ServoError, match="does not answer"), face.bus:
        pass


def test_a_reboot_clears_a_latched_error_and_leaves_the_servo_limp():
    face = MemoryFace(2, faults=[Fault("shock", servos=(0,), at_s=(1.0,))])
    with face.bus:
        awake(face)
        run(face, 1.5, [0.0, 0.0])
        health = face.bus.look_after()
        assert health.hardware_errors.tolist() == [0x10, 0]
        assert health.torque_on.tolist() == [False, True]
        face.bus.reboot(0)
        run(face, 1.0, [0.0, 0.0])

        assert face.bus.look_after().hardware_errors.tolist() == [0, 0]
        assert face.bus.enable_torque(0) == ""


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


def capped(max_current_ma):
    (servo,) = mounted(1)
    return MountedServo(servo.joint, servo.model, 1, 0.0, max_current_ma)


def test_a_current_cap_begins_at_a_third_and_is_never_exceeded():
    """147 mA of an XL330-M288, which stalls at 1.47 A: a tenth of its torque."""
    face = MemoryFace(servos=[capped(147.0)])
    (servo,) = face.chain.servos
    with face.bus:
        awake(face)
        assert servo["goal_current"] == 44
        assert not face.bus.at_full_strength
        run(face, 1.5, [0.0])
        assert servo["goal_current"] == 147
        assert face.bus.at_full_strength
        face.chain.motors.load[0] = 0.2  # more than the cap lets it lift
        run(face, 1.0, [10.0])

        assert face.bus.read().positions_deg[0] == pytest.approx(0.0, abs=0.2)


def test_full_strength_reaches_a_servo_although_packets_are_lost():
    lost = Fault("drop_instruction", probability=0.3, from_s=1.0)
    # The watchdog trips in the silence before 1 s; with this seed its clearing is not lost.
    face = MemoryFace(servos=[capped(147.0)], faults=[lost], seed=2)
    with face.bus:
        awake(face)
        face.clock.sleep_until(1.0)
        run(face, 1.5, [0.0])

        assert face.chain.servos[0]["goal_current"] == 147


@pytest.mark.parametrize(("register", "value"), [("operating_mode", 3), ("current_limit", 1750)])
def test_a_servo_that_would_not_keep_its_cap_is_refused(register, value):
    face = MemoryFace(servos=[capped(147.0)])
    face.chain.servos[0][register] = value
    with pytest.raises(ServoError, match="setup-servos"), face.bus:
        pass


def test_a_model_without_a_current_sensor_has_no_cap():
    (servo,) = mounted(1, "XL430-W250")
    with pytest.raises(ValueError, match="does not measure current"):
        MountedServo(servo.joint, servo.model, max_current_ma=100.0)


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
        servos, lambda: DisturbedTransport(chain, clock, random.Random(0), fast=False)
    ) as bus:
        assert bus.remarks() == ()
        for _ in range(10):
            bus.feedback()
        assert ["Fast Sync Read" in each for each in bus.remarks()] == [True]
