"""The judge of a stop sees a late servo, one that comes on again, and a shaft that moves."""

import threading
import time

import pytest
from lipservo_lab.bench.stops import stop_campaign as stop_judge
from lipservo_lab.bench.stops.robot_at_port import robot_at_port
from lipservo_lab.bench.stops.running_face import RunningFace
from lipservo_lab.bench.stops.stop_campaign import judge_frozen, judge_limp
from lipservo_lab.bench.stops.stop_cases import StopCase, StopOutcome
from lipservo_lab.bench.stops.stop_clients import Addresses, Requested
from lipservo_lab.bench.stops.troubles import Trouble

from firmware_bridge.stopping import StopLevel

LIMP = StopCase(StopLevel.LIMP, Trouble.POLLERS)
FREEZE = StopCase(StopLevel.FREEZE, Trouble.POLLERS)


@pytest.fixture
def face(monkeypatch):
    """A robot, and a process that does not answer in place of a daemon; the judge is in a hurry."""
    for name, seconds in {"LATE_S": 0.2, "BRAKES_S": 0.05, "_WATCH_S": 0.6}.items():
        monkeypatch.setattr(stop_judge, name, seconds)
    with robot_at_port() as robot:
        process = robot.start_python("-c", "import time; time.sleep(60)")
        yield RunningFace(robot, process, Addresses(robot.folder / "no.sock"))


def limp_outcome(face):
    outcome = StopOutcome(LIMP)
    now_s = time.monotonic()
    judge_limp(face, LIMP, Requested(now_s), now_s, outcome)
    return outcome


def test_servos_that_are_limp_in_time_and_stay_so_are_well(face):
    outcome = limp_outcome(face)

    assert outcome.kept, str(outcome)
    assert outcome.limp_after_s == 0.0


def test_a_servo_that_keeps_its_torque_is_late_and_left_on(face):
    face.robot.chain.motors.torque_on[1:3] = True

    outcome = limp_outcome(face)

    assert (outcome.late, outcome.torque_left_on, outcome.undone) == (2, 2, 0)


def test_a_servo_that_gets_torque_after_the_stop_is_undone(face):
    def come_on():
        face.robot.chain.motors.torque_on[:] = True

    coming = threading.Timer(0.4, come_on)
    coming.start()
    outcome = limp_outcome(face)
    coming.join()

    assert outcome.late == 0
    assert outcome.undone == len(face.robot.servos)
    assert not outcome.kept


def test_a_frozen_shaft_that_moves_is_seen(face):
    def move():
        face.robot.chain.motors.position[0] += 100.0

    outcome, now_s = StopOutcome(FREEZE), time.monotonic()
    moving = threading.Timer(0.4, move)
    moving.start()
    judge_frozen(face, FREEZE, now_s, outcome)
    moving.join()

    assert outcome.moved_frozen == 1
    assert not outcome.kept
