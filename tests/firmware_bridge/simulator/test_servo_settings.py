"""Settings that change what a servo does, each against what its manual says of it."""

import struct

import pytest
from servo_bench import Bench

from firmware_bridge.clock import ManualClock
from firmware_bridge.dynamixel.wire.codec import StatusError
from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.simulator.ports import MemoryTransport

REVERSED, TIMED = 1, 4


def moved(bench, goal, timeout_s=10.0):
    """Seconds until it rests at `goal`, which it is given now, with torque on."""
    began_s = bench.now_s
    assert bench.write("goal_position", goal) == 0
    bench.wait(0.01)
    while bench.read("moving_status") & 0x02:  # profile ongoing
        bench.wait(0.01)
        assert bench.now_s - began_s < timeout_s
    return bench.now_s - began_s


@pytest.mark.parametrize("distance", [100, 1000])
@pytest.mark.parametrize(("span_ms", "rise_ms"), [(1500, 0), (1500, 300), (1500, 750), (800, 800)])
def test_a_time_based_profile_takes_its_time_whatever_the_distance(distance, span_ms, rise_ms):
    """https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/#profile-velocity112"""
    bench = Bench()
    bench.write("drive_mode", TIMED)
    bench.write("profile_velocity", span_ms)
    bench.write("profile_acceleration", rise_ms)
    bench.write("torque_enable", 1)

    assert moved(bench, 2048 + distance) == pytest.approx(span_ms / 1e3, abs=0.04)


def test_what_is_slow_as_a_speed_is_fast_as_a_time():
    """44 is 60 deg/s, or 44 ms: what soft start asks for, and what it would get."""
    turned_deg = []
    for drive_mode in (0, TIMED):
        bench = Bench()
        bench.write("drive_mode", drive_mode)
        bench.write("profile_velocity", 44)
        bench.write("torque_enable", 1)
        bench.write("goal_position", 2048 + 512)
        bench.wait(0.2)
        turned_deg.append(bench.shaft_deg())

    assert turned_deg == pytest.approx([10.0, 45.0], abs=3.0)


def test_a_new_profile_velocity_counts_from_the_next_goal_on():
    bench = Bench()
    bench.write("profile_velocity", 20)
    bench.write("torque_enable", 1)
    bench.write("goal_position", 3000)
    bench.write("profile_velocity", 200)
    bench.wait(0.5)
    slow = bench.read("position_trajectory") - 2048
    bench.write("goal_position", 3001)
    bench.wait(0.5)

    assert slow == pytest.approx(20 * 0.229 * 4096 / 60 * 0.5, rel=0.05)
    assert bench.read("position_trajectory") == 3001


@pytest.mark.parametrize(
    ("velocity", "acceleration", "goal", "shape"),
    [
        (0, 0, 3000, 0b00),  # step
        (50, 0, 3000, 0b01),  # rectangular
        (100, 10, 2100, 0b10),  # triangular: sqrt(A D) = 1,127 ... of 1,563 pulses a second
        (100, 10, 4000, 0b11),  # trapezoidal
    ],
)
def test_moving_status_tells_the_shape_of_the_profile(velocity, acceleration, goal, shape):
    """https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/#moving-status123"""
    bench = Bench()
    bench.write("profile_velocity", velocity)
    bench.write("profile_acceleration", acceleration)
    bench.write("torque_enable", 1)
    bench.write("goal_position", goal)
    bench.wait(0.02)
    assert bench.read("moving_status") & 0x33 == shape << 4 | (0x02 if velocity else 0x00)
    bench.wait(5.0)
    assert bench.read("moving_status") == shape << 4 | 0x01
    assert not bench.read("moving")


def test_a_jammed_servo_says_that_it_does_not_follow():
    bench = Bench()
    bench.write("torque_enable", 1)
    bench.chain.motors.jammed[0] = True
    bench.write("goal_position", 3000)
    bench.wait(0.3)

    assert bench.read("moving_status") & 0x09 == 0x08


def test_a_limp_servo_moves_not_whatever_goal_it_holds():
    bench = Bench()
    bench.write("goal_position", 3000)
    bench.wait(0.1)

    assert bench.read("moving") == 0


def test_in_reverse_mode_the_shaft_turns_the_other_way():
    bench = Bench()
    bench.write("drive_mode", REVERSED)
    assert bench.read("present_position") == 2048
    bench.write("torque_enable", 1)
    bench.write("goal_position", 2048 + 512)
    bench.wait(0.05)
    assert bench.read("present_velocity") > 0
    assert bench.read("present_current") > 0
    bench.wait(1.0)

    assert bench.read("present_position") == 2048 + 512
    assert bench.shaft_deg() == pytest.approx(-45.0, abs=0.1)


@pytest.mark.parametrize("drive_mode", [0, REVERSED])
def test_the_homing_offset_is_added_to_the_place_and_not_reversed(drive_mode):
    """Present = actual + offset; https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/#homing-offset20"""
    bench = Bench()
    bench.write("drive_mode", drive_mode)
    bench.write("homing_offset", 500)
    assert bench.read("present_position") == 2548
    bench.write("torque_enable", 1)
    bench.write("goal_position", 2048)
    bench.wait(1.0)

    assert bench.read("present_position") == 2048
    turned_deg = -500 * 360 / 4096
    assert bench.shaft_deg() == pytest.approx(-turned_deg if drive_mode else turned_deg, abs=0.1)


@pytest.mark.parametrize(("mode", "shown"), [(3, 2048), (4, 2048 - 2000)])
def test_one_turn_ignores_a_homing_offset_of_more_than_a_quarter(mode, shown):
    bench = Bench()
    bench.write("operating_mode", mode)
    assert bench.write("homing_offset", -2000) == 0

    assert bench.read("present_position") == shown


def test_position_limits_are_in_the_frame_of_the_homing_offset():
    bench = Bench()
    bench.write("homing_offset", 1000)
    bench.write("max_position_limit", 2600)

    assert bench.write("goal_position", 3048) == StatusError.DATA_LIMIT
    assert bench.write("goal_position", 2600) == 0


def test_torque_in_one_turn_forgets_whole_turns():
    """As told in https://forum.robotis.com/t/7814 : 3700 became -396 with an offset of -512."""
    bench = Bench()
    bench.write("homing_offset", -512)
    bench.chain.motors.position[0] = 3700 + 512
    assert bench.read("present_position") == 3700
    bench.write("torque_enable", 1)

    assert bench.read("present_position") == -396


def test_several_turns_are_counted_and_cleared():
    bench = Bench()
    bench.write("operating_mode", 4)
    bench.write("torque_enable", 1)
    bench.write("goal_position", 3 * 4096 + 100)
    bench.wait(0.1)
    clear = b"\x01\x44\x58\x4c\x22"
    assert bench.ask(0x10, clear) == StatusError.RESULT_FAIL  # while it moves
    bench.wait(4.0)
    assert bench.read("present_position") == 3 * 4096 + 100
    assert bench.ask(0x10, clear) == 0
    bench.wait(1.0)

    assert bench.read("present_position") == 100
    assert bench.ask(0x10, b"\x02") == StatusError.DATA_RANGE


def test_a_long_way_at_top_speed_is_no_overload_but_a_jam_is():
    free, jammed = Bench(), Bench()
    jammed.chain.motors.jammed[0] = True
    for bench in (free, jammed):
        bench.write("operating_mode", 4)
        bench.write("torque_enable", 1)
        bench.write("goal_position", 20_000)
        bench.wait(2.0)

    assert free.read("hardware_error_status") == 0
    assert 0 < free.read("present_current") < 0.2 * 1470
    assert jammed.read("hardware_error_status") == 0x20


@pytest.fixture
def stuffed():
    """A servo whose motion reads FF FF FD: -1 mA and a velocity of -3; and a line to it."""
    bench = Bench(baud_rate=1_000_000)
    bench.write("profile_velocity", 3)
    bench.write("torque_enable", 1)
    bench.chain.motors.load[0] = 0.0005
    bench.write("goal_position", 1000)
    bench.wait(1.0)
    assert bench.servo.read_span(126, 3)[1] == b"\xff\xff\xfd"
    return bench


def test_a_reading_that_looks_like_a_header_is_stuffed_on_the_wire_and_read_by_our_line(stuffed):
    """https://github.com/pollen-robotics/rustypot/pull/121"""
    clock = ManualClock(stuffed.now_s)
    heard = []

    class Tapped(MemoryTransport):
        def read(self, deadline_s):
            data = super().read(deadline_s)
            heard.append(data)
            return data

    status = Line(Tapped(stuffed.chain, clock)).read(1, 126, 10)

    assert b"\xff\xff\xfd\xfd\xff\xff\xff" in b"".join(heard)
    assert struct.unpack_from("<hi", status.data) == (-1, -3)
