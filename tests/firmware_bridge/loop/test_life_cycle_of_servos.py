"""Single servos in a face's life: given up, exchanged, silent, critical; who gets torque again."""

import numpy as np
import pytest
from driven_robot import Robot
from dynamixel_chain import MemoryFace, mounted

from firmware_bridge.errors import ServoError
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.face_table import FaceState
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import MemoryTargetChannel
from firmware_bridge.simulator.faults import Fault


def test_a_servo_given_up_is_not_switched_on_again_by_a_replug_or_a_silence():
    def jam(robot):
        robot.face.chain.motors.jammed[1] = True
        robot.face.chain.motors.position[1] += 400.0

    unplug = Fault("unplug", at_s=(18.0,), lasts_s=1.0)
    robot = Robot(unplug, stops=[(25.0, "soft")])
    given_up = {}
    robot.live(
        60.0,
        {
            2.0: lambda: jam(robot),
            17.0: lambda: given_up.update(robot.bridge.given_up),
        },
    )

    assert "does not follow" in given_up[1]
    assert robot.told.failures == given_up
    assert not any(torque[1] for time_s, torque, _ in robot.seen if time_s > 17.0)
    assert all(torque[0] for time_s, torque, _ in robot.seen if 21.0 < time_s < 24.5)


def test_a_servo_given_up_by_an_earlier_process_stays_limp():
    robot = Robot(stops=[(4.0, "soft")], given_up={2: "does not follow"})
    robot.live(60.0)

    assert not any(torque[2] for _, torque, _ in robot.seen)
    assert any(torque[0] for _, torque, _ in robot.seen)


def test_a_soft_stop_waits_for_no_limp_servo_and_does_not_call_it_at_rest():
    robot = Robot(stops=[(4.0, "soft")], given_up={2: "does not follow"})
    robot.face.chain.motors.position[2] += 1800.0  # its way to neutral would take .8 s
    report = robot.live(60.0)

    assert 4.5 < robot.face.clock.now() < 4.75
    assert report.complete
    assert not report.at_rest
    assert np.abs(robot.sent_deg[-1][1][:2]).max() < 1e-6


@pytest.mark.parametrize(
    ("register", "value", "why"),
    [
        ("homing_offset", 500, "has homing offset 500"),
        ("drive_mode", 1, "has drive mode 1"),
        ("drive_mode", 4, "has drive mode 4"),
        ("operating_mode", 4, "is in operating mode 4, not 3"),
        ("operating_mode", 5, "is in operating mode 5, not 3"),
        ("max_position_limit", 2100, "has limits"),
    ],
)
def test_a_servo_that_came_back_another_one_gets_no_torque(register, value, why):
    """Switched off and on, or exchanged, while the face runs: it is asked anew, every time."""
    robot = Robot(Fault("silence", servos=(0,), at_s=(0.5,), lasts_s=1.0), stops=[(3.7, "soft")])
    found = {}

    def exchange():
        servo = robot.face.chain.servos[0]
        servo.reboot(robot.face.clock.now())
        servo[register] = value

    robot.live(60.0, {1.1: exchange, 3.5: lambda: found.update(troubles=robot.bridge.troubles)})

    assert not any(torque[0] for time_s, torque, _ in robot.seen if time_s > 1.2)
    assert why in found["troubles"][0]


def test_strict_or_not_a_servo_outside_its_own_range_gets_no_torque():
    """Its own limits, not the joint's, decide whether it can hold where it stands."""
    for tolerant in (False, True):
        robot = Robot(tolerant=tolerant, stops=[(2.0, "soft")])
        robot.face.chain.motors.position[0] = 3500.0
        if tolerant:
            robot.live(60.0)
        else:
            with pytest.raises(ServoError, match="outside its own range"):
                robot.live(60.0)
        assert robot.torque_writes(0.0) == [] or tolerant
        assert not any(torque[0] for _, torque, _ in robot.seen)


def test_a_dry_run_cannot_arm_even_after_a_pulled_plug_and_a_stall():
    robot = Robot(Fault("unplug", at_s=(2.0,), lasts_s=1.0), stops=[(20.0, "soft")], dry_run=True)
    robot.live(60.0, {5.0: lambda: robot.face.clock.advance(3.0), 12.0: lambda: None})

    assert robot.torque_writes(0.0) == []
    assert not any(any(torque) for _, torque, _ in robot.seen)


def test_a_start_does_not_fail_for_answers_that_a_busy_computer_misses():
    """A servo is silent for longer than two questions last, in the middle of the start."""
    robot = Robot(tolerant=False, stops=[(2.0, "soft")])
    servo, ask = robot.face.chain.servos[1], robot.face.bus.obstacle
    asked = []

    def silent_at_first(index):
        if index == 1 and not asked:
            asked.append(index)
            servo.deaf_until_s = robot.face.clock.now() + 0.05
        return ask(index)

    robot.face.bus.obstacle = silent_at_first
    report = robot.live(60.0)

    assert asked
    assert report.complete
    assert any(all(torque) for _, torque, _ in robot.seen)


def test_what_is_unusual_about_the_line_is_said_once():
    robot = Robot(stops=[(5.0, "soft")])
    robot.face.bus.remarks = lambda: ("the adapter echoes",)
    robot.live(60.0)

    assert robot.log.count("the adapter echoes") == 1


def test_a_watchdog_that_was_lost_is_set_again():
    robot = Robot(stops=[(6.0, "soft")])
    found = []
    robot.live(
        60.0,
        {
            2.0: lambda: robot.face.chain.servos[1].write(bytes((98, 0, 0))),
            5.5: lambda: found.append(robot.face.chain.servos[1]["bus_watchdog"]),
        },
    )

    assert found == [5]


def test_a_critical_servo_that_fails_stops_the_face_and_says_why():
    robot = Robot(servos=mounted(3, critical=True))

    def jam():
        robot.face.chain.motors.jammed[1] = True
        robot.face.chain.motors.position[1] += 400.0

    with pytest.raises(ServoError, match=r"critical servo 'joint_2' .* the face was stopped"):
        robot.live(120.0, {2.0: jam})

    assert robot.stiff == []
    assert robot.bridge.state is FaceState.ENDED


LOSSES = [Fault(kind, probability=0.2) for kind in ("drop_instruction", "drop_reply")]


@pytest.mark.parametrize("seed", range(8))
def test_a_start_succeeds_where_a_fifth_of_all_packets_is_lost_either_way(seed):
    """Four starts in ten were refused; who holds does so where it stood."""
    face = MemoryFace(10, faults=LOSSES, seed=seed)
    bridge = Bridge(face.bus, face.joints, MemoryTargetChannel(), BridgeSettings(100.0))
    with face.bus:
        stood = face.chain.motors.position.copy()
        bridge.start()
        face.clock.sleep_until(face.clock.now() + 0.05)

        assert bridge.state is FaceState.DRIVEN
        assert [servo["torque_enable"] for servo in face.chain.servos] == [1] * 10
        goals = [servo["goal_position"] for servo in face.chain.servos]
        np.testing.assert_allclose(goals, stood, atol=1.0)
        np.testing.assert_allclose(face.chain.motors.position, stood, atol=1.0)


def test_where_one_servo_never_answers_a_start_ends_soon_and_nobody_holds():
    """The tries that make up for lost packets have an end."""
    face = MemoryFace(10, faults=[*LOSSES, Fault("silence", servos=(3,), at_s=(0.0,))], seed=1)
    bridge = Bridge(face.bus, face.joints, MemoryTargetChannel(), BridgeSettings(100.0))
    face.clock.advance(0.01)
    begun_s = face.clock.now()
    with pytest.raises(ServoError, match=r"'joint_4' \(id 4\) does not answer"), face.bus:
        bridge.start()

    assert face.clock.now() - begun_s < 2.0
    assert [servo["torque_enable"] for servo in face.chain.servos] == [0] * 10


def test_the_log_says_why_a_face_is_let_go_whose_speech_side_hangs():
    robot = Robot(stops=[(20.0, "soft")])
    publish = robot.channel.publish

    def hang():
        robot.channel.publish = lambda _targets: None

    def recover():
        robot.channel.publish = publish

    robot.live(60.0, {2.0: hang, 12.0: recover})

    silence, again = (
        [i for i, line in enumerate(robot.log) if words in line]
        for words in ("no motion comes from speech", "motion comes again")
    )
    assert len(silence) == len(again) == 1
    assert silence < again
    assert not any(any(torque) for time_s, torque, _ in robot.seen if 9.0 < time_s < 12.0)


def test_the_first_fault_of_a_servo_is_logged_while_another_keeps_missing_answers():
    """It was named when it was given up: each change of the other servo began the wait anew."""
    missing = Fault("silence", servos=(0,), at_s=tuple(np.arange(3.0, 12.0, 0.8)), lasts_s=0.3)
    robot = Robot(missing, stops=[(12.0, "soft")])
    logged = []

    def jam():
        robot.face.chain.motors.jammed[1] = True
        robot.face.chain.motors.position[1] += 400.0

    robot.live(60.0, {2.0: jam, 8.0: lambda: logged.extend(robot.log)})

    assert any("'joint_2'" in line and "does not follow" in line for line in logged)
    assert not any("given up" in line for line in logged)
