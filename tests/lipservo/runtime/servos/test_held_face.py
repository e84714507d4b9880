"""A face held and led through bridge and gate, on servos simulated to the byte, in virtual time."""

import os
import signal
import threading
import time

import numpy as np
import pytest
from dynamixel_chain import MemoryFace
from hobby_bus import on_maestro_yaml, on_pca9685

from calibration.fit.servo_response import identify
from calibration.mouth_servos import JointRange
from firmware_bridge.dynamixel.mounting import mounted_servos
from firmware_bridge.errors import PortGone, ServoError
from firmware_bridge.maestro import simulator as simulated_maestro
from firmware_bridge.pca9685 import simulator as simulated_pca9685
from firmware_bridge.pulse_bus import STAGGER_S
from firmware_bridge.simulator.faults import Fault
from firmware_bridge.stopping import StopReport
from lipservo.runtime.servos.face_stopped import FaceStopped
from lipservo.runtime.servos.held_face import HeldFace, held_rate_hz
from lipservo.settings.settings import FaceSettings, load_shipped_face, parse_face

ENCODER_STEP_DEG = 360.0 / 4096.0


def settings_of(name="face_four", **changes):
    return FaceSettings.model_validate(load_shipped_face(name).model_dump() | changes)


def held(settings, **options):
    face = MemoryFace(servos=mounted_servos(settings.wiring))
    return face, HeldFace(settings, face.clock, bus=face.bus, **options)


def test_the_mouth_is_led_slowly_and_stands_where_it_was_told():
    face, robot = held(settings_of())
    goal = np.array([10.0, -20.0, 15.0, 5.0])
    with robot:
        began_s = face.clock.now()
        reached = robot.move(goal)
        assert face.clock.now() - began_s > 20.0 / 30.0
        assert np.abs(reached - goal).max() < 1.0
        assert all(servo.torque_on for servo in face.chain.servos)
    assert not any(servo.torque_on for servo in face.chain.servos)
    neutral = [servo.pulse(0.0) for servo in face.servos]
    assert face.chain.motors.position == pytest.approx(neutral, abs=6)


def test_no_goal_on_the_wire_leaves_the_limits_or_breaks_a_rule():
    rule = {"joints": {"jaw": 1.0, "lip_protrusion": 1.0}, "above": 20.0, "because": "they touch"}
    _, robot = held(settings_of(prevent=[rule]), speed_deg_s=200.0)
    with robot:
        reached = robot.move(np.array([90.0, 0.0, 0.0, 0.0]))
        assert reached[0] <= 20.0 + 2 * ENCODER_STEP_DEG
        reached = robot.move(np.array([18.0, 0.0, 0.0, 30.0]))
        assert reached[0] + reached[3] <= 20.0 + 4 * ENCODER_STEP_DEG


#: A face of hobby servos, its YAML and who simulates them.
HOBBY = {
    "maestro": (on_maestro_yaml, simulated_maestro),
    "pca9685": (on_pca9685, simulated_pca9685),
}


def held_hobby_servos(kind):
    of, simulator = HOBBY[kind]
    settings = parse_face(of(load_shipped_face("face_four")), "face.yaml")
    on = simulator.watched_servos(settings.wiring)
    return on, HeldFace(settings, on.clock, bus=on.bus)


@pytest.mark.parametrize("kind", HOBBY)
def test_a_held_face_waits_until_the_last_hobby_servo_got_its_pulse(kind):
    on, robot = held_hobby_servos(kind)
    with robot:
        assert robot.torque_on == [True] * 4
        assert 3 * STAGGER_S <= on.clock.now() < 8.0
        reached = robot.move(np.array([5.0, -5.0, 5.0, -5.0]))
        assert reached == pytest.approx([5.0, -5.0, 5.0, -5.0])
        assert robot.sent_deg == pytest.approx([5.0, -5.0, 5.0, -5.0])
        assert on.shafts_deg() == pytest.approx([5.0, -5.0, 5.0, -5.0], abs=0.5)
    assert on.bus.torque.as_json() == [False] * 4


@pytest.mark.parametrize("kind", HOBBY)
def test_a_hobby_servo_gets_the_time_that_its_speed_needs_for_the_way(kind):
    of, simulator = HOBBY[kind]
    face = load_shipped_face("face_four")
    servos = {name: {"max_speed_deg_s": 20.0} for name in face.servos}
    slow = FaceSettings.model_validate(
        parse_face(of(face), "face.yaml").model_dump()
        | {
            "servos": {
                name: servo | servos[name]
                for name, servo in parse_face(of(face), "face.yaml").model_dump()["servos"].items()
            }
        }
    )
    on = simulator.watched_servos(slow.wiring)
    with HeldFace(slow, on.clock, bus=on.bus, speed_deg_s=400.0) as robot:
        began_s = on.clock.now()
        robot.move(np.array([0.0, -20.0, 0.0, 0.0]))
        assert on.clock.now() - began_s > 20.0 / 20.0
        assert on.shafts_deg() == pytest.approx([0.0, -20.0, 0.0, 0.0], abs=0.5)


def test_a_hobby_servo_that_gets_no_pulse_is_named_and_nothing_is_held():
    on, robot = held_hobby_servos("maestro")
    on.device.channels[2].set_target = lambda *_: None
    with pytest.raises(ServoError, match=r"'corner_right_out'.* is not known to hold"), robot:
        pass
    assert on.clock.now() < 10.0
    assert on.bus.torque.as_json() == [False] * 4


def test_other_joints_than_the_mouth_stay_at_rest():
    face, robot = held(settings_of("face_head"), speed_deg_s=200.0)
    with robot:
        assert robot.move(np.full(10, 5.0)).shape == (10,)
    neck = [i for i, s in enumerate(face.servos) if s.joint.name.startswith("neck")]
    assert neck
    for data in (data for _, data in face.written[-200:]):
        assert data  # the wire was used
    assert [face.chain.motors.position[i] for i in neck] == pytest.approx(
        [face.servos[i].pulse(0.0) for i in neck], abs=3
    )


def test_a_servo_that_is_held_up_shows_in_what_it_reached():
    face, robot = held(settings_of(), speed_deg_s=200.0)
    with robot:
        face.chain.motors.jammed[0] = True
        reached = robot.move(np.array([15.0, 10.0, 0.0, 0.0]))
        assert abs(reached[0]) < 1.0
        assert reached[1] == pytest.approx(10.0, abs=1.0)
        face.chain.motors.jammed[0] = False


def test_a_servo_that_says_nothing_is_not_taken_for_one_that_stands():
    settings = settings_of("face_jaw")
    mute = Fault("answers_stop", at_s=(2.2,), lasts_s=1.0)
    face = MemoryFace(servos=mounted_servos(settings.wiring), faults=(mute,))
    with HeldFace(settings, face.clock, bus=face.bus) as robot:
        robot.hold(2.0 - face.clock.now())
        assert robot.move(np.array([15.0])) == pytest.approx(15.0, abs=1.0)
        assert face.clock.now() > 3.2


def test_lag_speed_and_bandwidth_are_found_over_the_wire():
    """The simulated servo closes its error with 40 / s, and follows the gate's 300 deg/s."""
    settings = settings_of("face_jaw")
    _, robot = held(settings)
    joints = [JointRange(n, s.min_deg, s.max_deg) for n, s in settings.mouth_servos.items()]
    assert robot.rate_hz == held_rate_hz(settings) == 50.0
    with robot:
        found = identify(robot.drive, joints, np.zeros(1), rate_hz=robot.rate_hz)
    assert 0.0 <= found.lag_s[0] < 0.05
    assert found.bandwidth_hz[0] > 6.0
    assert found.top_speed_deg_s[0] == pytest.approx(300.0, rel=0.15)


def test_a_question_is_asked_while_the_servos_are_held():
    _, robot = held(settings_of())

    def ask():
        time.sleep(0.05)
        return "7 8 9"

    with robot:
        n_ticks = robot._driven.bridge.counts.n_ticks
        assert robot.hold_while(ask) == "7 8 9"
        assert robot._driven.bridge.counts.n_ticks > n_ticks
        with pytest.raises(EOFError, match="no more"):
            robot.hold_while(lambda: (_ for _ in ()).throw(EOFError("no more")))


def test_a_job_moves_the_servos_from_a_thread_of_its_own_and_its_errors_are_raised():
    _, robot = held(settings_of(), speed_deg_s=200.0)
    goal = np.array([10.0, -20.0, 15.0, 5.0])
    with robot:
        ticks = threading.current_thread()

        def job(here):
            assert threading.current_thread() is not ticks
            assert here(threading.current_thread) is ticks
            return here(lambda: robot.move(goal))

        assert np.abs(robot.work(job) - goal).max() < 1.0
        with pytest.raises(ValueError, match="in the job"):
            robot.work(lambda _: (_ for _ in ()).throw(ValueError("in the job")))
        with pytest.raises(TimeoutError):
            robot.work(lambda here: here(lambda: (_ for _ in ()).throw(TimeoutError())))


def test_a_stop_does_not_wait_for_a_job_that_computes():
    face, robot = held(settings_of())
    computing, may_end = threading.Event(), threading.Event()

    def job(_):
        os.kill(os.getpid(), signal.SIGTERM)
        computing.set()
        may_end.wait(60.0)

    def work():
        with robot:
            robot.work(job)

    with pytest.raises(FaceStopped):
        work()
    assert computing.is_set()
    assert not any(servo.torque_on for servo in face.chain.servos)
    may_end.set()


def test_a_plug_that_is_pulled_ends_it():
    settings = settings_of()
    pulled = Fault("unplug", at_s=(2.0,), lasts_s=60.0)
    face = MemoryFace(servos=mounted_servos(settings.wiring), faults=(pulled,))

    def hold():
        with HeldFace(settings, face.clock, bus=face.bus) as robot:
            robot.hold(2.0)
            robot.move(np.ones(4))

    with pytest.raises(PortGone, match="plug it in and go on with what was kept"):
        hold()


def test_a_signal_after_a_pulled_plug_is_a_stop_that_nobody_confirmed():
    settings = settings_of()
    pulled = Fault("unplug", at_s=(2.0,), lasts_s=60.0)
    face = MemoryFace(servos=mounted_servos(settings.wiring), faults=(pulled,))

    def hold():
        with HeldFace(settings, face.clock, bus=face.bus) as robot:
            robot.hold(2.0)
            os.kill(os.getpid(), signal.SIGTERM)
            robot.move(np.ones(4))

    with pytest.raises(FaceStopped) as stopped:
        hold()
    assert stopped.value.exit_status == 3
    assert len(stopped.value.report.unconfirmed) == 4


@pytest.mark.parametrize(
    ("unconfirmed", "signal_number", "status"),
    [({}, None, 5), ({}, signal.SIGTERM, 143), ({"jaw": "no answer"}, None, 3)],
)
def test_a_command_that_was_stopped_before_it_was_done_says_so(unconfirmed, signal_number, status):
    report = StopReport(confirmed=("lip",), unconfirmed=unconfirmed)
    assert FaceStopped(report, signal_number).exit_status == status


def test_a_lost_sample_at_the_start_neither_moves_a_joint_nor_keeps_it_for_ever():
    settings = settings_of()
    lost = Fault("drop_reply", probability=0.2)
    face = MemoryFace(servos=mounted_servos(settings.wiring), faults=(lost,))
    with HeldFace(settings, face.clock, bus=face.bus, from_neutral=False) as robot:
        assert np.abs(robot.stands_deg).max() < 1.0
        robot.lead(np.array([5.0, 0.0, 0.0, 0.0]))

    assert robot.life.report.complete
    assert face.clock.now() < 10.0


def test_another_rate_than_its_own_is_refused():
    _, robot = held(settings_of("face_jaw"))
    with robot, pytest.raises(ValueError, match="driven at 50 Hz, not 100"):
        robot.drive(np.zeros((5, 1)), 100.0)


@pytest.mark.parametrize("fault", [Fault("overheat", at_s=(2.0,), lasts_s=60.0, amount=66.0),
                                   Fault("brown_out", at_s=(2.0,), lasts_s=60.0)])  # fmt: skip
def test_a_servo_that_is_hot_or_lost_its_power_is_not_taken_for_one_at_its_goal(fault):
    settings = settings_of("face_jaw")
    face = MemoryFace(servos=mounted_servos(settings.wiring), faults=(fault,))
    with HeldFace(settings, face.clock, bus=face.bus) as robot:
        robot.move(np.array([6.0]))
        robot.check_sent_whole()
        robot.hold(4.0 - face.clock.now())
        robot.move(np.array([4.0]))
        with pytest.raises(
            ServoError, match=r"jaw was sent .* of 4\.0 deg: too hot, without power"
        ):
            robot.check_sent_whole()
        with pytest.raises(ServoError, match="run the same command again"):
            robot.drive(np.full((5, 1), 4.0), robot.rate_hz)


def test_a_joint_that_was_let_go_as_jammed_shows_only_in_what_it_reached():
    face, robot = held(settings_of())
    with robot:
        face.chain.motors.jammed[0] = True
        robot.move(np.array([15.0, 0.0, 0.0, 0.0]))
        robot.hold(2.0)
        assert robot.torque_on[0] is False
        assert abs(robot.stands_deg[0]) < 1.0
        robot.check_sent_whole()
        face.chain.motors.jammed[0] = False
