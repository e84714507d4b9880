"""Starts: stops that come while servos are armed, and a person's start, which tries every servo."""

import math
import os
import signal

import numpy as np
import pytest
from driven_robot import Robot
from dynamixel_chain import mounted

from firmware_bridge.loop.face_table import FaceState
from firmware_bridge.loop.life_table import LifeState
from firmware_bridge.stopping import StopLevel

N = 4
NAMES = [f"joint_{each}" for each in range(1, N + 1)]


def at_armed(robot, n, act):
    """Let something happen as soon as n servos are armed."""
    enable, done = robot.face.bus.enable_torque, []

    def enable_and_act(index):
        why_not = enable(index)
        if len(robot.stiff) == n and not done:
            done.append(robot.face.clock.now())
            act()
        return why_not

    robot.face.bus.enable_torque = enable_and_act
    return done


def stop(robot, level, *, ends=False):
    return lambda: robot.control.commands.stop(level, "a test", ends=ends)


def face_that_starts(kind, **options):
    """One that arms all in one go, or of which a person starts all servos by ticks."""
    if kind == "in one go":
        return Robot(n=N, tolerant=False, **options)
    return Robot(n=N, servos=mounted(N, critical=True), waits=True, **options)


@pytest.mark.parametrize("kind", ["in one go", "by ticks"])
@pytest.mark.parametrize("n", range(1, N + 1))
def test_a_freeze_while_servos_are_armed_holds_those_that_are_and_arms_no_more(kind, n):
    robot = face_that_starts(kind)
    frozen_s = at_armed(robot, n, stop(robot, StopLevel.FREEZE))
    answers, states = [], {}

    def look():
        answers.append(robot.control.of_stop)
        states.update(robot.control.status, life=robot.life.state, stiff=robot.stiff)
        robot.control.commands.stop(StopLevel.LIMP, "a test", ends=True)

    robot.live(30.0, {6.0: look})

    assert frozen_s
    assert (states["state"], states["life"]) == ("frozen", LifeState.FROZEN)
    assert answers[0] == {"holds": NAMES[:n], "limp": NAMES[n:], "unknown": []}
    assert states["stiff"] == list(range(n))
    assert robot.torque_writes(frozen_s[0] + 0.05) == []
    assert robot.told.stops == [StopLevel.FREEZE, StopLevel.LIMP]
    assert robot.stiff == []


@pytest.mark.parametrize("kind", ["in one go", "by ticks"])
@pytest.mark.parametrize("level", [StopLevel.SOFT, StopLevel.LIMP])
def test_a_soft_or_limp_stop_while_servos_are_armed_lets_go_and_is_not_undone(kind, level):
    robot = face_that_starts(kind)
    stopped_s = at_armed(robot, 2, stop(robot, level))
    report = robot.live(5.0)

    assert report.complete
    assert robot.stiff == []
    assert robot.torque_writes(stopped_s[0] + 0.05) == []
    assert robot.control.end["confirmed"] == NAMES


@pytest.mark.parametrize("kind", ["in one go", "by ticks"])
@pytest.mark.parametrize("n_signals", [1, 2])
def test_a_signal_while_servos_are_armed_lets_go(kind, n_signals):
    robot = face_that_starts(kind)

    def press():
        for _ in range(n_signals):
            os.kill(os.getpid(), signal.SIGTERM)

    signalled_s = at_armed(robot, 2, press)
    report = robot.live(20.0)

    assert report.complete
    assert robot.torque_writes(signalled_s[0] + 0.05) == []
    assert robot.face.clock.now() < signalled_s[0] + 3.0
    assert robot.life.stopped_by_person


def test_a_freeze_of_a_limp_face_says_that_nothing_is_held_and_it_can_still_be_started():
    robot = Robot(stops=[(1.0, "limp"), (2.0, "freeze")], waits=True)
    answers = []

    def look():
        answers.append((robot.control.of_stop, robot.control.status))
        robot.say("start")

    robot.live(6.0, {3.0: look})

    answer, status = answers[0]
    assert answer == {"holds": [], "limp": ["joint_1", "joint_2", "joint_3"], "unknown": []}
    assert (status["state"], status["stopped"], status["can_start"]) == ("stopped", "limp", True)
    assert all(all(torque) for time_s, torque, _ in robot.seen if 4.5 < time_s < 5.5)


def test_a_freeze_that_comes_after_the_face_was_let_go_is_not_called_one():
    robot = Robot(stops=[(2.0, "limp"), (2.1, "freeze")])
    told = []

    def fall_deaf():
        robot.face.chain.servos[2].ignore_until(3.0)

    robot.live(10.0, {1.9: fall_deaf, 2.5: lambda: told.append(dict(robot.control.status))})

    assert told[0]["stopped"] == "limp"
    assert robot.bridge.state is FaceState.ENDED


@pytest.mark.parametrize("first", ["start", "stop"])
def test_of_a_start_and_a_stop_in_one_tick_the_stop_holds(first):
    robot = Robot(stops=[(1.0, "limp")], waits=True)

    def both():
        asks = [lambda: robot.say("start"), stop(robot, StopLevel.FREEZE)]
        for ask in asks if first == "start" else reversed(asks):
            ask()

    robot.live(5.0, {2.0: both})

    assert not any(any(torque) for time_s, torque, _ in robot.seen if time_s > 2.0)
    assert robot.torque_writes(1.5) == []
    assert any("a stop came with it" in line for line in robot.log)


def test_a_stop_while_a_person_starts_the_face_again_is_answered_and_not_undone():
    stops = [(1.0, "limp"), (6.0, "limp")]  # a frozen face is held beyond the program's end
    robot = Robot(servos=mounted(3, critical=True), stops=stops, waits=True)
    obstacle = robot.face.bus.obstacle

    def stop_in_the_middle(index):
        if index == 1 and robot.face.clock.now() > 2.0:
            stop(robot, StopLevel.FREEZE)()
        return obstacle(index)

    def start():
        robot.face.bus.obstacle = stop_in_the_middle
        robot.say("start")

    found = {}
    robot.live(5.0, {2.5: start, 4.0: lambda: found.update(robot.control.status)})

    assert found["state"] == "frozen"
    assert robot.torque_writes(2.0) == []
    assert any("stopped meanwhile by a test" in line for line in robot.log)
    assert None not in robot.told.stops  # the supervisor is not told that it was started


def test_a_signal_while_a_person_starts_the_face_again_is_said_and_no_start_is_told():
    robot = Robot(servos=mounted(3, critical=True), stops=[(1.0, "limp")], waits=True)
    obstacle = robot.face.bus.obstacle

    def signal_in_the_middle(index):
        if index == 1:
            os.kill(os.getpid(), signal.SIGTERM)
        return obstacle(index)

    def start():
        robot.face.bus.obstacle = signal_in_the_middle
        robot.say("start")

    robot.live(6.0, {2.5: start})

    assert any("stopped meanwhile by a signal" in line for line in robot.log)
    assert None not in robot.told.stops
    assert robot.stiff == []


def test_the_supervisor_hears_the_loop_while_a_deaf_servo_is_asked_again_and_again():
    robot = Robot(servos=mounted(3, critical=True), stops=[(2.0, "limp")], waits=True)
    beats_s, beat = [], robot.told.beat
    robot.told.beat = lambda: (beats_s.append(robot.face.clock.now()), beat())

    def break_and_start():
        robot.face.chain.servos[1].ignore_until(math.inf)
        robot.say("start")

    robot.live(8.0, {3.0: break_and_start})

    assert any("joint_2" in line and "does not answer" in line for line in robot.log)
    assert np.diff(beats_s).max() < 0.3


def limp_at_the_fifth_try(robot, ask):
    """Let the last servo fall deaf to what it is asked, and a person stop the face meanwhile."""
    asked, tries, servo = getattr(robot.face.bus, ask), [], robot.face.chain.servos[-1]

    def try_once(index):
        if index == servo.index:
            servo.ignore_until(robot.face.clock.now() + 0.2)
            tries.append(index)
            if len(tries) == 5:
                stop(robot, StopLevel.LIMP)()
        return asked(index)

    setattr(robot.face.bus, ask, try_once)
    return tries


def test_a_stop_while_a_deaf_servo_is_asked_again_and_again_is_obeyed_and_said():
    robot, tries = Robot(servos=mounted(3, critical=True), stops=[(1.0, "limp")], waits=True), []

    def start():
        tries.append(limp_at_the_fifth_try(robot, "obstacle"))
        robot.say("start")

    robot.live(6.0, {2.5: start})

    assert len(tries[0]) == 5
    assert [line for line in robot.log if "start requested" in line] == [
        "start requested by a test: stopped meanwhile by a test"
    ]


def test_a_stop_while_a_servo_does_not_confirm_its_torque_ends_the_start_and_refuses_nothing():
    robot = face_that_starts("in one go")
    tries = limp_at_the_fifth_try(robot, "enable_torque")
    report = robot.live(5.0)

    assert len(tries) == 5
    assert report.complete
    assert robot.stiff == []


def test_a_start_by_a_person_tries_servos_again_that_were_given_up():
    robot = Robot(given_up={1: "does not follow"}, stops=[(2.0, "limp"), (6.0, "limp")], waits=True)
    found = {}
    at = {
        1.5: lambda: found.update(before=robot.stiff),
        3.0: lambda: robot.say("start"),
        5.0: lambda: found.update(after=robot.stiff, troubles=robot.bridge.troubles),
    }
    robot.live(8.0, at)

    assert found == {"before": [0, 2], "after": [0, 1, 2], "troubles": ()}
    assert robot.bridge.given_up == {}


@pytest.mark.parametrize("tolerant", [True, False])
def test_a_start_by_a_person_goes_on_without_a_servo_that_is_not_critical_and_names_it(tolerant):
    servos = [*mounted(2, critical=True), *mounted(3)[2:]]
    robot = Robot(servos=servos, stops=[(2.0, "limp")], waits=True, tolerant=tolerant)
    found = {}

    def break_and_start():
        robot.face.chain.servos[2].ignore_until(float("inf"))
        robot.say("start")

    def look():
        found.update(stiff=robot.stiff, troubles=robot.bridge.troubles, state=robot.bridge.state)

    robot.live(8.0, {3.0: break_and_start, 6.0: look})

    assert (found["stiff"], found["state"]) == ([0, 1], FaceState.DRIVEN)
    assert ["joint_3" in line and "does not answer" in line for line in found["troubles"]] == [True]
    assert None in robot.told.stops


def test_a_start_by_a_person_fails_for_a_critical_servo_and_says_which():
    robot = Robot(servos=mounted(3, critical=True), stops=[(2.0, "limp")], waits=True)
    found = {}

    def break_and_start():
        robot.face.chain.servos[1].ignore_until(6.0)
        robot.say("start")

    at = {
        3.0: break_and_start,
        6.5: lambda: found.update(robot.control.status, stiff=robot.stiff),
        7.0: lambda: robot.say("start"),
        9.0: lambda: found.update(again=robot.stiff),
    }
    robot.live(10.0, at)

    assert (found["state"], found["stiff"], found["can_start"]) == ("stopped", [], True)
    assert (found["stopped"], found["stopped_by"]) == ("limp", "a test")
    assert any("joint_2" in line and "does not answer" in line for line in robot.log)
    assert found["again"] == [0, 1, 2]


def test_a_servo_switched_on_while_the_face_is_stopped_is_driven_from_the_start_on():
    robot = Robot(stops=[(2.0, "limp")], waits=True)
    found = {}
    at = {
        1.5: lambda: robot.say("servo joint_2 off"),
        3.0: lambda: found.update(answer=robot.say("servo joint_2 on")),
        4.0: lambda: found.update(stopped=robot.stiff),
        4.1: lambda: robot.say("start"),
        6.0: lambda: found.update(started=robot.stiff),
    }
    robot.live(7.0, at)

    assert found["answer"] == {"servo": "joint_2", "asked": "on"}
    assert (found["stopped"], found["started"]) == ([], [0, 1, 2])
    assert robot.told.switches == [(1, False), (1, True)]


def test_a_servo_switched_off_while_the_face_is_stopped_stays_off_over_the_start():
    robot = Robot(stops=[(2.0, "limp")], waits=True)
    found = {}
    at = {
        3.0: lambda: robot.say("servo joint_2 off"),
        4.0: lambda: robot.say("start"),
        6.0: lambda: found.update(started=robot.stiff, state=robot.state("joint_2")),
    }
    robot.live(7.0, at)

    assert found == {"started": [0, 2], "state": "off"}


def test_a_start_leaves_a_servo_limp_that_had_failed_before_a_person_switched_it_off():
    robot = Robot(given_up={1: "does not follow"}, stops=[(2.0, "limp")], waits=True)
    found = {}
    at = {
        1.0: lambda: robot.say("servo joint_2 off"),
        4.0: lambda: robot.say("start"),
        6.0: lambda: found.update(stiff=robot.stiff, state=robot.state("joint_2")),
    }
    robot.live(7.0, at)

    assert found == {"stiff": [0, 2], "state": "off"}
