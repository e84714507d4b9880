"""One simulated servo against the e-manual: errors, locks, traps, profile, heat, overload."""

import struct

import numpy as np
import pytest
from servo_bench import MODEL, Bench

from firmware_bridge.dynamixel.wire.codec import Instruction, StatusError
from firmware_bridge.simulator.chain import SimulatedChain
from firmware_bridge.simulator.motors import Environment


@pytest.mark.parametrize(
    ("address", "data", "error"),
    [
        (64, b"\1", StatusError.NONE),
        (64, b"\2", StatusError.DATA_RANGE),  # torque_enable is 0 or 1
        (132, bytes(4), StatusError.ACCESS),  # present_position is read-only
        (50, b"\0", StatusError.ACCESS),  # nothing begins there
        (116, b"\0\0", StatusError.DATA_LENGTH),  # half of goal_position
        (116, struct.pack("<i", 4096), StatusError.DATA_LIMIT),
        (104, struct.pack("<i", 446), StatusError.DATA_LIMIT),  # above the velocity limit, 445
        (11, b"\1", StatusError.DATA_RANGE),  # velocity mode is not simulated
        (9, b"\xff", StatusError.DATA_RANGE),  # return delay ends at 254
        (300, b"\0", StatusError.ACCESS),
        (116, b"", StatusError.DATA_LENGTH),
    ],
)
def test_writes_are_refused_for_the_reason_in_the_manual(address, data, error):
    """https://emanual.robotis.com/docs/en/dxl/protocol2/#error"""
    assert Bench().raw_write(address, data) == error


@pytest.mark.parametrize("instruction", [32, 146, 147, 154, 0x77])
def test_what_is_not_simulated_is_refused_with_the_instruction_error(instruction):
    assert Bench().servo.answer(instruction, b"", 0.0) == (StatusError.INSTRUCTION, b"")


def test_a_refused_write_changes_nothing_of_what_it_carried():
    bench = Bench()
    data = struct.pack("<II", 50, 40_000)  # acceleration is fine, velocity is too large

    assert bench.raw_write(108, data) == StatusError.DATA_RANGE
    assert bench.read("profile_acceleration") == 0


def test_eeprom_is_locked_while_torque_is_on():
    """https://github.com/ROBOTIS-GIT/DynamixelSDK/issues/355"""
    bench = Bench()
    bench.write("torque_enable", 1)
    assert bench.write("return_delay_time", 0) == StatusError.ACCESS
    bench.write("torque_enable", 0)
    assert bench.write("return_delay_time", 0) == 0


def test_a_reboot_keeps_eeprom_forgets_ram_and_is_deaf_for_a_while():
    bench = Bench()
    bench.write("return_delay_time", 0)
    bench.write("profile_velocity", 77)
    bench.servo.answer(Instruction.REBOOT, b"", 0.0)

    assert bench.servo.deaf_until_s > 0.0
    assert bench.read("return_delay_time") == 0
    assert bench.read("profile_velocity") == 0


@pytest.mark.parametrize(("keep", "kept_id", "kept_rate"), [(0xFF, 1, 1), (1, 9, 1), (2, 9, 3)])
def test_a_factory_reset_keeps_what_it_is_told_to(keep, kept_id, kept_rate):
    bench = Bench()
    bench.write("id", 9)
    bench.write("baud_rate", 3)
    bench.servo.answer(Instruction.FACTORY_RESET, bytes((keep,)), 0.0)

    assert (bench.read("id"), bench.read("baud_rate")) == (kept_id, kept_rate)


def test_torque_on_runs_to_the_goal_that_was_left_there():
    """The trap that arming avoids; https://github.com/pollen-robotics/reachy_mini/issues/1136"""
    bench = Bench()
    bench.write("goal_position", 3000)
    bench.write("torque_enable", 1)
    bench.wait(2.0)

    assert bench.read("present_position") == pytest.approx(3000, abs=1)


def test_the_watchdog_stops_the_servo_and_refuses_goals_until_cleared():
    bench = Bench()
    bench.write("torque_enable", 1)
    bench.write("bus_watchdog", 5)
    bench.write("goal_position", 4000)
    bench.wait(0.11)
    stopped = bench.read("present_position")
    bench.wait(2.0)

    assert bench.read("bus_watchdog") == -1
    assert bench.read("present_position") == pytest.approx(stopped, abs=2)
    assert bench.servo.torque_on
    assert bench.write("goal_position", 4000) == StatusError.DATA_RANGE
    bench.write("bus_watchdog", 0)
    assert bench.write("goal_position", 4000) == 0


@pytest.mark.parametrize(
    ("distance", "velocity", "acceleration"), [(1024, 100, 20), (512, 50, 10), (1024, 200, 0)]
)
def test_a_profile_takes_its_time(distance, velocity, acceleration):
    """Trapezoid: t = D / V + V / A; https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/#profile-velocity112"""
    bench = Bench()
    bench.write("profile_velocity", velocity)
    bench.write("profile_acceleration", acceleration)
    bench.write("torque_enable", 1)
    bench.write("goal_position", 2048 + distance)
    while bench.read("moving"):
        bench.wait(0.01)
    speed = velocity * 0.229 * 4096 / 60
    rate = acceleration * 214.577 * 4096 / 3600
    expected_s = distance / speed + (speed / rate if rate else 0.0)

    assert bench.now_s == pytest.approx(expected_s, abs=0.034)


def test_no_profile_makes_a_servo_faster_than_its_motor():
    bench = Bench()
    bench.write("torque_enable", 1)
    bench.write("goal_position", 4000)
    bench.wait(0.1)

    assert bench.shaft_deg() == pytest.approx(0.1 * MODEL.no_load_deg_s, rel=0.1)


def test_a_lasting_overload_latches_switches_off_and_only_a_reboot_helps():
    bench = Bench()
    bench.write("torque_enable", 1)
    bench.chain.motors.load[0] = 0.9
    bench.wait(1.5)
    assert bench.read("hardware_error_status") == 0x20
    assert not bench.servo.torque_on
    bench.chain.motors.load[0] = 0.0
    bench.wait(1.0)
    assert bench.write("torque_enable", 1) == 0x80 | StatusError.ACCESS
    bench.servo.reboot(bench.now_s)
    assert bench.write("torque_enable", 1) == 0


def test_a_stalled_servo_grows_hot_and_cools_when_let_go():
    bench = Bench()
    bench.write("torque_enable", 1)
    bench.chain.motors.load[0] = 0.7
    bench.wait(30.0, step_s=1.0)
    hot = bench.read("present_temperature")
    bench.write("torque_enable", 0)
    bench.wait(300.0, step_s=1.0)

    assert hot > 30
    assert bench.read("present_temperature") <= hot - 4


def test_many_stalled_servos_make_the_supply_sag():
    chain = SimulatedChain([MODEL] * 10, range(1, 11), environment=Environment(supply_ohm=0.2))
    for servo in chain.servos:
        servo.write(struct.pack("<H", 64) + b"\1")
    chain.motors.load[:] = 0.7
    chain.advance(0.5)

    assert chain.motors.voltage_v[0] == pytest.approx(
        5.0 - 0.2 * 10 * (0.7 * 1.47 + 0.017), abs=0.2
    )


def test_current_limited_mode_is_weaker():
    strong, weak = Bench(), Bench()
    weak.write("operating_mode", 5)
    weak.write("goal_current", 500)
    for bench in (strong, weak):
        bench.write("torque_enable", 1)
        bench.chain.motors.load[0] = 0.4
        bench.write("goal_position", 3000)
        bench.wait(0.5)

    assert strong.read("present_position") > 2900
    assert weak.read("present_position") == pytest.approx(2048, abs=2)


def test_indirect_data_shows_and_sets_registers_elsewhere():
    bench = Bench()
    assert bench.raw_write(168, struct.pack("<5H", 132, 133, 134, 135, 65)) == 0

    assert bench.servo.read_span(208, 4)[1] == struct.pack("<i", 2048)
    assert bench.raw_write(212, b"\1") == 0
    assert bench.read("led") == 1
    assert bench.raw_write(208, bytes(4)) == StatusError.ACCESS


@pytest.mark.parametrize(("level", "read", "write"), [(0, 0, 0), (1, 1, 0), (2, 1, 1)])
def test_the_status_return_level_decides_who_is_answered(level, read, write):
    bench = Bench()
    bench.servo["status_return_level"] = level
    answers = [
        bench.servo.answer(Instruction.PING, b"", 0.0),
        bench.servo.answer(Instruction.READ, struct.pack("<HH", 64, 1), 0.0),
        bench.servo.answer(Instruction.WRITE, struct.pack("<HB", 65, 1), 0.0),
    ]

    assert [answer is not None for answer in answers] == [True, bool(read), bool(write)]


def test_the_same_seed_gives_the_same_bytes():
    from dynamixel_chain import MemoryFace

    from firmware_bridge.simulator.faults import Fault

    def heard(seed):
        face = MemoryFace(
            5, faults=[Fault("corrupt_reply", probability=0.2, from_s=1.0)], seed=seed
        )
        with face.bus:
            face.clock.sleep_until(1.0)
            return [face.bus.feedback().age_s.tolist() for _ in range(50)]

    assert heard(3) == heard(3) != heard(4)
    assert np.isfinite(heard(3)).all()
