"""Torque, strength, operating modes and limits of a simulated servo, as its manual has them."""

import struct

import numpy as np
import pytest
from servo_bench import MODEL, Bench

from firmware_bridge.dynamixel.control_table import servo_models
from firmware_bridge.dynamixel.wire.codec import StatusError

TORQUE_BY_GOAL = 8


def test_a_goal_switches_torque_on_where_the_drive_mode_says_so():
    bench = Bench()
    bench.write("goal_position", 2500)
    assert not bench.servo.torque_on
    bench.write("drive_mode", TORQUE_BY_GOAL)
    bench.write("goal_position", 2600)
    bench.wait(1.0)

    assert bench.servo.torque_on
    assert bench.read("present_position") == 2600


def test_a_goal_does_not_enable_a_servo_that_a_hardware_error_has_stopped():
    bench = Bench()
    bench.write("drive_mode", TORQUE_BY_GOAL)
    bench.servo.latch(0x20)
    bench.write("goal_position", 2600)

    assert not bench.servo.torque_on


def test_a_servo_told_so_holds_its_place_once_it_has_booted():
    bench = Bench()
    bench.write("startup_configuration", 1)
    bench.chain.motors.position[0] = 2300
    bench.servo.reboot(0.0)
    bench.wait(0.4)
    assert not bench.servo.torque_on
    bench.wait(0.2)

    assert bench.servo.torque_on
    assert bench.read("goal_position") == bench.read("present_position") == 2300


def test_nothing_is_backed_up_so_ram_falls_back_to_its_defaults():
    bench = Bench()
    bench.write("startup_configuration", 2)
    bench.write("position_p_gain", 77)
    assert bench.ask(0x20, b"\x01CTRL") == StatusError.INSTRUCTION
    bench.servo.reboot(0.0)

    assert bench.read("backup_ready") == 0
    assert bench.read("position_p_gain") == MODEL.defaults["position_p_gain"]


def test_goal_pwm_is_its_limit_after_a_restart_and_caps_the_speed():
    bench = Bench()
    bench.write("pwm_limit", 442)
    bench.servo.reboot(0.0)
    assert bench.read("goal_pwm") == 442
    bench.write("torque_enable", 1)
    bench.write("goal_position", 4000)
    bench.wait(0.1)
    half_deg = bench.shaft_deg()
    assert bench.read("present_pwm") == 442
    assert bench.write("goal_pwm", 443) == StatusError.DATA_LIMIT
    assert bench.write("goal_pwm", 0) == 0
    bench.wait(0.5)

    assert half_deg == pytest.approx(0.05 * MODEL.no_load_deg_s, rel=0.1)
    assert bench.shaft_deg() == pytest.approx(half_deg, abs=4.0)


def test_goal_pwm_caps_the_strength():
    bench = Bench()
    bench.write("goal_pwm", 265)  # 30 %
    bench.write("torque_enable", 1)
    bench.chain.motors.load[0] = 0.35
    bench.write("goal_position", 3000)
    bench.wait(0.5)

    assert bench.read("present_position") == pytest.approx(2048, abs=2)


def test_current_has_the_sign_of_the_push():
    bench = Bench()
    bench.write("torque_enable", 1)
    bench.chain.motors.load[0] = 0.2
    for goal, sign in ((3000, 1), (2000, -1)):
        bench.write("goal_position", goal)
        bench.wait(0.1)
        assert np.sign(bench.read("present_current")) == sign
        assert np.sign(bench.read("present_pwm")) == sign
        bench.wait(1.0)
        # It still holds its load, in the direction it came from.
        assert bench.read("present_current") == pytest.approx(sign * 0.2 * 1470, abs=15)


def test_a_model_without_current_sensor_shows_signed_load():
    bench = Bench(servo_models()["XL430-W250"])
    bench.write("torque_enable", 1)
    bench.chain.motors.load[0] = 0.25
    bench.write("goal_position", 1000)
    bench.wait(2.0)

    assert bench.read("present_current") == pytest.approx(-250, abs=15)


def test_another_mode_resets_what_the_manual_says():
    """https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/#operating-mode11"""
    bench = Bench()
    for name, value in (
        ("profile_velocity", 50),
        ("profile_acceleration", 5),
        ("position_p_gain", 900),
        ("goal_pwm", 100),
        ("goal_current", 100),
        ("goal_position", 3000),
    ):
        bench.write(name, value)
    bench.write("operating_mode", 3)  # as before: nothing changes
    assert bench.read("profile_velocity") == 50
    bench.write("operating_mode", 5)

    assert bench.read("profile_velocity") == bench.read("profile_acceleration") == 0
    assert bench.read("position_p_gain") == MODEL.defaults["position_p_gain"]
    assert bench.read("goal_pwm") == MODEL.defaults["pwm_limit"]
    assert bench.read("goal_current") == MODEL.defaults["current_limit"]
    assert bench.read("goal_position") == 2048


@pytest.mark.parametrize(
    ("model", "taken"),
    [("XL330-M288", {3, 4, 5}), ("XL430-W250", {3, 4}), ("XM430-W350", {3, 4, 5})],
)
def test_a_model_takes_the_modes_that_it_has(model, taken):
    bench = Bench(servo_models()[model])

    found = {mode for mode in range(20) if bench.write("operating_mode", mode) == 0}

    assert found == taken


@pytest.mark.parametrize("drive_mode", [2, 6, 16, 255])
def test_a_drive_mode_of_other_servos_is_refused(drive_mode):
    assert Bench().write("drive_mode", drive_mode) == StatusError.DATA_RANGE


def test_only_zero_clears_a_tripped_watchdog():
    bench = Bench()
    bench.write("torque_enable", 1)
    bench.write("bus_watchdog", 5)
    bench.wait(0.2)

    assert bench.write("bus_watchdog", 5) == StatusError.DATA_RANGE
    assert bench.read("bus_watchdog") == -1
    assert bench.write("goal_position", 2100) == StatusError.DATA_RANGE
    assert bench.write("goal_pwm", 100) == StatusError.DATA_RANGE
    assert bench.write("bus_watchdog", 0) == 0
    assert bench.write("bus_watchdog", 5) == 0
    assert bench.write("goal_position", 2100) == 0


def test_limits_out_of_order_are_refused():
    bench = Bench()

    assert bench.write("min_position_limit", 1000) == 0
    assert bench.write("max_position_limit", 999) == StatusError.DATA_LIMIT
    assert bench.raw_write(48, struct.pack("<II", 1500, 1600)) == StatusError.DATA_LIMIT
    assert bench.raw_write(48, struct.pack("<II", 500, 400)) == 0
    assert bench.read("max_position_limit") == 500
