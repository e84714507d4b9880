"""Servos that fingers turn: torque off on the wire and read back, and nothing switched on."""

import numpy as np
import pytest
from driven_robot import TORQUE_ON
from dynamixel_chain import MemoryFace, enable_all

from firmware_bridge.dynamixel.mounting import mounted_servos
from firmware_bridge.dynamixel.wire import codec
from firmware_bridge.errors import PortGone
from firmware_bridge.simulator.faults import Fault
from lipservo.runtime.servos.limp_servos import LimpServos
from lipservo.settings.settings import load_shipped_face


def limp_face(name="face_four", **options):
    settings = load_shipped_face(name)
    face = MemoryFace(servos=mounted_servos(settings.wiring), **options)
    return face, LimpServos(settings, face.bus, face.clock)


def turn(face, index, angle_deg):
    """What fingers do."""
    face.chain.servos[index].stand_at(face.servos[index].pulse(angle_deg))


def sent(face, since):
    return [data for _, data in face.written[since:]]


def test_torque_goes_off_by_a_write_to_each_servo_and_is_read_back():
    face, limp = limp_face()
    with face.bus:
        enable_all(face)
        since = len(face.written)
        report = limp.let_go()
        ids = [servo.joint.servo_id for servo in face.servos]
        for servo_id in ids:
            assert codec.write(servo_id, 64, b"\0") in sent(face, since)
            assert codec.read(servo_id, 64, 1) in sent(face, since)
        assert report.complete
        assert report.confirmed == limp.names
        assert not any(servo.torque_on for servo in face.chain.servos)


def test_whatever_is_done_nothing_is_ever_switched_on_or_given_a_goal():
    face, limp = limp_face()
    with face.bus:
        limp.let_go()
        turn(face, 0, 8.0)
        limp.steady_pose()
        limp.let_go()
    for data in sent(face, 0):
        assert data[7:11] != TORQUE_ON
        assert not (data[7] == 0x83 and data[8:10] == bytes((116, 0)))  # sync write of goals


def test_servos_that_are_not_of_the_mouth_are_left_as_they_are():
    face, limp = limp_face("face_head")
    with face.bus:
        enable_all(face)
        limp.let_go()
        holding = [
            servo.joint.name
            for servo, simulated in zip(face.servos, face.chain.servos, strict=True)
            if simulated.torque_on
        ]
        settings = load_shipped_face("face_head")
        assert holding == [name for name in settings.servos if name not in limp.names]
        assert len(holding) > 2


def test_a_servo_that_does_not_answer_is_named_and_nothing_is_said_of_it():
    face, limp = limp_face(faults=[Fault("silence", (1,), at_s=(2.0,), lasts_s=9.0)])
    with face.bus:
        enable_all(face)
        face.clock.sleep_until(2.5)
        report = limp.let_go()
        deaf = limp.names[1]
        assert list(report.unconfirmed) == [deaf]
        assert deaf not in report.confirmed
        assert "does not answer" in report.unconfirmed[deaf]
        assert list(limp.steady_pose().obstacles) == [deaf]


def test_a_pose_is_where_the_joints_stood_for_a_third_of_a_second():
    face, limp = limp_face()
    with face.bus:
        limp.let_go()
        turn(face, 0, 12.0)
        turn(face, 2, -7.5)
        began_s = face.clock.now()
        pose = limp.steady_pose()
        assert face.clock.now() - began_s > 0.29
        assert pose.obstacles == {}
        assert pose.positions_deg == pytest.approx([12.0, 0.0, -7.5, 0.0], abs=0.1)


def test_a_hand_that_moves_and_a_servo_that_holds_are_in_the_way():
    face, limp = limp_face()
    jaw, other = limp.names[0], limp.names[1]
    with face.bus:
        limp.let_go()
        wait, places = face.clock.sleep_until, iter(np.linspace(0.0, 10.0, 40))

        def moving(time_s):
            turn(face, 0, next(places, 10.0))
            wait(time_s)

        face.clock.sleep_until = moving
        face.bus.enable_torque(1)
        obstacles = limp.steady_pose().obstacles
    assert "still moves" in obstacles[jaw]
    assert "torque is on" in obstacles[other]


def test_a_lost_sample_is_no_silence():
    faults = [Fault("drop_reply", probability=0.1, from_s=1.0)]
    face, limp = limp_face(faults=faults, seed=3)
    with face.bus:
        face.clock.sleep_until(1.0)
        assert limp.let_go().complete
        assert any(limp.read_pose().obstacles for _ in range(30))
        assert limp.steady_pose().obstacles == {}


def test_a_pulled_plug_is_said_and_nobody_counts_as_limp():
    face, limp = limp_face(faults=[Fault("unplug", at_s=(3.0,), lasts_s=9.0)])
    with face.bus:
        assert limp.let_go().complete
        face.clock.sleep_until(3.5)
        with pytest.raises(PortGone):
            limp.steady_pose()
        report = limp.let_go()
        assert report.confirmed == ()
        assert set(report.unconfirmed) == set(limp.names)
