"""Torque of a face's servos: what comes before it, what limits it, and off for certain."""

import numpy as np
import pytest
from dynamixel_chain import BAUD_RATE, MemoryFace, enable_all, mounted, run

from firmware_bridge.dynamixel.mounting import MountedServo
from firmware_bridge.dynamixel.torque import LineRelease
from firmware_bridge.dynamixel.wire import codec
from firmware_bridge.errors import ServoError
from firmware_bridge.simulator.faults import Fault


def test_torque_off_reaches_everybody_although_packets_are_lost():
    face = MemoryFace(5, faults=[Fault("drop_instruction", probability=0.3, from_s=1.0)], seed=6)
    with face.bus:
        enable_all(face)
        face.clock.sleep_until(1.0)
        assert face.bus.disable_all().all()

    assert not any(servo.torque_on for servo in face.chain.servos)


@pytest.mark.parametrize("listed", [[1, 2, 3], []])
def test_a_release_is_said_three_times_to_the_listed_servos_and_then_to_all(listed):
    face = MemoryFace(3)
    for servo in face.chain.servos:
        servo["torque_enable"] = 1
    LineRelease(face.open(), (BAUD_RATE,)).tell_all(listed)
    sent = [data for _, data in face.written]

    by_name = codec.sync_write(64, 1, [(each, b"\0") for each in listed])
    everybody = codec.write(codec.BROADCAST_ID, 64, b"\0")
    assert sent.count(by_name if listed else everybody) >= 3
    assert everybody in sent
    assert not any(servo.torque_on for servo in face.chain.servos)


def test_leaving_switches_torque_off_even_after_an_exception():
    face = MemoryFace(3)

    def fail():
        with face.bus:
            enable_all(face)
            raise RuntimeError

    with pytest.raises(RuntimeError):
        fail()

    assert not any(servo.torque_on for servo in face.chain.servos)


def test_the_servos_stop_by_themselves_when_we_fall_silent_and_go_on_when_we_return():
    face = MemoryFace(2)
    with face.bus:
        enable_all(face)
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


def test_enabling_torque_moves_nothing_whatever_goal_the_servo_remembers():
    face = MemoryFace(1)
    face.chain.servos[0]["goal_position"] = 2300
    with face.bus:
        before = face.bus.read().positions_deg
        assert face.bus.enable_torque(0) == ""
        face.clock.advance(0.05)

        np.testing.assert_allclose(face.bus.read().positions_deg, before, atol=0.1)


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
        enable_all(face)
        run(face, 1.5, [0.0, 0.0])
        health = face.bus.look_after()
        assert health.hardware_errors.tolist() == [0x10, 0]
        assert health.torque.tolist() == [False, True]
        face.bus.reboot(0)
        run(face, 1.0, [0.0, 0.0])

        assert face.bus.look_after().hardware_errors.tolist() == [0, 0]
        assert face.bus.enable_torque(0) == ""


def capped(max_current_ma):
    (servo,) = mounted(1)
    return MountedServo(servo.joint, servo.model, 1, 0.0, max_current_ma)


def test_a_current_cap_begins_at_a_third_and_is_never_exceeded():
    """147 mA of an XL330-M288, which stalls at 1.47 A: a tenth of its torque."""
    face = MemoryFace(servos=[capped(147.0)])
    (servo,) = face.chain.servos
    with face.bus:
        enable_all(face)
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
        enable_all(face)
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
