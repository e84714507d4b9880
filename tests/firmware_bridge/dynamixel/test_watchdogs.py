"""Watchdogs are renewed after a pause of ours and never before; soft starts end in time."""

import numpy as np
import pytest
from dynamixel_chain import MemoryFace, enable_all, mounted, run

from firmware_bridge.dynamixel.mounting import MountedServo
from firmware_bridge.dynamixel.torque import Watchdogs
from firmware_bridge.simulator.faults import Fault

WATCHDOG, GOAL, PROFILE = 98, 116, 108
WRITE, SYNC_WRITE = 0x03, 0x83


def written(face, instruction=SYNC_WRITE):
    """Register and time of each packet of this kind."""
    return [
        (int.from_bytes(data[8:10], "little"), time_s)
        for time_s, data in face.written
        if data[7] == instruction
    ]


@pytest.mark.parametrize(
    ("timeout_s", "setting"),
    [(0.0, 0), (0.02, 1), (0.1, 5), (0.101, 6), (2.54, 127), (60.0, 127)],
)
def test_a_watchdog_waits_as_long_as_was_asked_or_as_long_as_it_can(timeout_s, setting):
    assert Watchdogs([1], timeout_s).setting == setting


def test_while_goals_come_no_watchdog_is_touched():
    face = MemoryFace(2)
    with face.bus:
        enable_all(face)
        run(face, 0.1, [0.0, 0.0])
        face.written.clear()
        run(face, 1.0, [0.0, 0.0])

    assert WATCHDOG not in [address for address, _ in written(face)]
    assert [servo["bus_watchdog"] for servo in face.chain.servos] == [5, 5]


@pytest.mark.parametrize(("pause_s", "renewed"), [(0.05, False), (0.11, True), (3.0, True)])
def test_after_a_pause_all_watchdogs_are_cleared_and_set_once_before_the_next_goal(
    pause_s, renewed
):
    face = MemoryFace(2)
    with face.bus:
        enable_all(face)
        run(face, 0.5, [0.0, 0.0])
        face.clock.advance(pause_s)
        face.written.clear()
        run(face, 0.2, [5.0, 5.0])
        goals = [address for address, _ in written(face) if address in (WATCHDOG, GOAL)]

        assert goals[:3] == ([WATCHDOG, WATCHDOG, GOAL] if renewed else [GOAL] * 3)
        assert goals.count(WATCHDOG) == (2 if renewed else 0)
        assert [servo["bus_watchdog"] for servo in face.chain.servos] == [5, 5]


def test_without_a_watchdog_a_pause_changes_nothing():
    face = MemoryFace(1, watchdog_s=0.0)
    with face.bus:
        enable_all(face)
        face.clock.advance(60.0)
        face.written.clear()
        run(face, 0.2, [5.0])

        assert WATCHDOG not in [address for address, _ in written(face)]
        assert face.chain.servos[0]["bus_watchdog"] == 0


def test_a_servo_that_does_not_take_its_watchdog_gets_no_torque():
    """Every write to it is lost: nothing would stop it once this computer has died."""
    face = MemoryFace(1, faults=[Fault("drop_instruction", probability=1.0, from_s=5.0)])
    with face.bus:
        face.clock.sleep_until(5.0)
        assert face.bus.enable_torque(0) != ""

    assert not face.chain.servos[0].torque_on


def test_a_servo_that_is_kept_is_not_said_to_have_tripped_any_more():
    face = MemoryFace(4)
    with face.bus:
        enable_all(face)
        face.chain.servos[2].trip_watchdog()
        for _ in range(8):
            face.bus.feedback()
            tripped = face.bus.look_after().watchdog_tripped
        assert tripped.tolist() == [False, False, True, False]

        assert face.bus.keep_torque(2)
        assert not any(face.bus.look_after().watchdog_tripped.any() for _ in range(4))


def test_a_servo_that_switched_its_watchdog_off_gets_it_back_and_one_that_tripped_does_not():
    """A restart forgets the setting; a trip is told of, and ends with the next goals."""
    face = MemoryFace(2)
    with face.bus:
        enable_all(face)
        run(face, 0.3, [0.0, 0.0])
        face.chain.servos[0]["bus_watchdog"] = 0
        run(face, 0.3, [0.0, 0.0])
        assert face.chain.servos[0]["bus_watchdog"] == 5

        face.clock.advance(1.0)
        face.written.clear()
        for _ in range(4):
            health = face.bus.look_after()
        assert health.watchdog_tripped.tolist() == [True, True]
        assert WATCHDOG not in [address for address, _ in written(face, WRITE)]


def test_a_limp_servo_gets_no_watchdog_by_itself():
    face = MemoryFace(2)
    with face.bus:
        enable_all(face)
        run(face, 0.3, [0.0, 0.0])
        assert face.bus.disable_torque(0)
        face.chain.servos[0]["bus_watchdog"] = 0
        run(face, 0.3, [0.0, 0.0])

        assert face.chain.servos[0]["bus_watchdog"] == 0
        assert [servo.torque_on for servo in face.chain.servos] == [False, True]


def test_torque_off_that_a_servo_does_not_confirm_is_not_said_to_be_off():
    face = MemoryFace(1, faults=[Fault("drop_instruction", probability=1.0, from_s=5.0)])
    with face.bus:
        enable_all(face)
        face.clock.sleep_until(5.0)

        assert not face.bus.disable_torque(0)
        assert not face.bus.disable_all().any()
        assert face.chain.servos[0].torque_on


def profile(servo):
    """Speed of a servo's own profile, degrees a second."""
    return servo["profile_velocity"] * 0.229 * 6.0


def test_a_servo_is_slow_for_a_second_and_then_as_fast_as_its_joint_and_no_faster():
    face = MemoryFace(1)
    (servo,) = face.chain.servos
    with face.bus:
        enable_all(face)
        assert profile(servo) == pytest.approx(60.0, abs=1.5)
        run(face, 0.9, [0.0])
        assert profile(servo) == pytest.approx(60.0, abs=1.5)
        assert not face.bus.at_full_strength
        run(face, 0.6, [0.0])

        assert profile(servo) == pytest.approx(300.0 * 1.05, abs=1.5)
        assert servo["profile_acceleration"] == 0
        assert face.bus.at_full_strength


def test_a_slow_joint_is_never_faster_than_itself_not_even_at_first():
    (servo,) = mounted(1)
    joint = type(servo.joint)("jaw", 1, -40.0, 40.0, 20.0)
    face = MemoryFace(servos=[MountedServo(joint, servo.model, 1, 0.0)])
    with face.bus:
        enable_all(face)

        assert profile(face.chain.servos[0]) == pytest.approx(20.0, abs=0.7)


def test_full_strength_is_said_three_times_a_tenth_of_a_second_apart():
    face = MemoryFace(1)
    with face.bus:
        enable_all(face)
        begun_s = face.clock.now()
        face.written.clear()
        run(face, 2.0, [0.0])
        said_s = np.array([time_s for address, time_s in written(face) if address == PROFILE])

    assert len(said_s) == 3
    np.testing.assert_allclose(said_s - begun_s, [1.0, 1.1, 1.2], atol=0.04)


def test_servos_that_came_on_one_after_another_are_all_at_full_strength_in_the_end():
    face = MemoryFace(2)
    with face.bus:
        assert face.bus.enable_torque(0) == ""
        run(face, 0.25, [0.0, 0.0])
        assert face.bus.enable_torque(1) == ""
        run(face, 2.0, [0.0, 0.0])

        assert face.bus.at_full_strength
        for servo in face.chain.servos:
            assert profile(servo) == pytest.approx(300.0 * 1.05, abs=1.5)


def test_torque_off_everywhere_ends_all_slow_starts():
    face = MemoryFace(2)
    with face.bus:
        enable_all(face)
        face.bus.disable_all()
        assert face.bus.at_full_strength
        face.written.clear()
        run(face, 1.5, [0.0, 0.0])

    assert PROFILE not in [address for address, _ in written(face)]


def test_a_servo_that_holds_is_kept_where_it_stands_and_a_limp_one_stays_limp():
    face = MemoryFace(2)
    with face.bus:
        assert face.bus.enable_torque(0) == ""
        face.chain.servos[0]["goal_position"] = 2300
        place = face.chain.servos[0]["present_position"]

        assert face.bus.keep_torque(0)
        assert not face.bus.keep_torque(1)
        assert abs(face.chain.servos[0]["goal_position"] - place) < 20
        assert face.chain.servos[0]["bus_watchdog"] == 5
        assert [servo.torque_on for servo in face.chain.servos] == [True, False]
