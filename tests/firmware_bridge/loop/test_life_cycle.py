"""A stop by a person holds, whatever happens to plug, servos and speech; what is said is true."""

import math
import os
import signal

import numpy as np
import pytest
from driven_robot import Robot
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from firmware_bridge.loop.face_table import FaceState
from firmware_bridge.simulator.faults import Fault
from firmware_bridge.stopping import StopLevel


def interrupt():
    """Ctrl-C, once."""
    os.kill(os.getpid(), signal.SIGINT)


@pytest.mark.parametrize(
    ("level", "at", "waits"),
    [
        ("soft", {}, True),
        ("freeze", {2.0: interrupt}, False),
    ],
)
def test_the_end_of_a_stop_says_whether_the_face_waits_for_a_start(level, at, waits):
    robot = Robot(stops=[(1.0, level)])
    robot.live(10.0, at)

    assert robot.control.end["waits"] is waits


def test_who_stopped_a_face_that_waits_is_told_the_end_of_it_at_once():
    robot, told = Robot(stops=[(1.0, "soft")], waits=True), {}
    robot.live(10.0, {5.0: lambda: told.update(robot.control.end)})

    assert (told["waits"], told["complete"]) == (True, True)


def test_every_tick_tells_the_supervisor_that_the_loop_lives():
    robot, at_first = Robot(tolerant=False), []
    robot.live(2.0, {0.0: lambda: at_first.append(robot.told.n_beats)})

    assert at_first[0] > 3, "while servos are armed, too"
    assert robot.told.n_beats - at_first[0] >= len(robot.seen) - 1 > 50


def test_of_a_port_that_is_there_nobody_says_that_it_is_gone(caplog):
    robot = Robot()
    robot.live(10.0, {2.0: interrupt})

    assert robot.stiff == []
    assert "port is gone" not in caplog.text


@pytest.mark.parametrize("level", ["soft", "limp"])
@pytest.mark.parametrize("stop_s", [1.0, 2.2, 3.05, 3.3])
def test_a_stop_while_the_plug_is_out_or_just_in_again_is_never_undone(level, stop_s):
    robot = Robot(Fault("unplug", at_s=(2.0,), lasts_s=1.0), stops=[(stop_s, level)])
    report = robot.live(60.0)

    assert robot.stiff == []
    assert report.complete
    assert robot.life.stopped_by_person
    assert robot.torque_writes(stop_s + 0.05) == []
    assert robot.face.clock.now() < max(stop_s, 3.0) + 3.0
    assert robot.told.stops == [StopLevel(level)]
    assert robot.control.end["complete"]


def test_a_face_frozen_while_the_plug_is_out_is_held_where_it_is_found_and_looked_after():
    plug = Fault("unplug", at_s=(2.0,), lasts_s=1.0)
    shock = Fault("shock", servos=(1,), at_s=(6.0,))
    robot = Robot(plug, shock, stops=[(2.5, "freeze"), (8.0, "soft")])
    states = {}
    robot.live(60.0, {7.9: lambda: states.update(troubles=robot.bridge.troubles)})

    held = [(torque, places) for time_s, torque, places in robot.seen if 3.5 < time_s < 5.9]
    assert all(all(torque) for torque, _ in held)
    assert np.ptp([places for _, places in held], axis=0).max() <= 1.0  # pulses
    assert robot.torque_writes(2.5) == []
    assert "electrical shock" in states["troubles"][0]
    assert robot.stiff == []


def test_a_frozen_servo_that_says_nothing_just_after_a_replug_has_its_watchdog_renewed():
    """Found by others: a watchdog that tripped stayed so, since one answer was lost."""
    plug = Fault("unplug", at_s=(2.0,), lasts_s=1.0)
    robot = Robot(plug, stops=[(2.5, "freeze"), (8.0, "soft")])
    tripped = []

    def fall_deaf():
        robot.face.chain.servos[1].deaf_until_s = 3.5

    def look():
        tripped.extend(servo["bus_watchdog"] for servo in robot.face.chain.servos)

    robot.live(60.0, {2.6: fall_deaf, 5.0: look})

    assert tripped == [5] * 3
    held = [torque for time_s, torque, _ in robot.seen if 3.5 < time_s < 7.9]
    assert all(all(torque) for torque in held)
    assert robot.torque_writes(2.5) == []


def test_a_frozen_servo_whose_place_is_missed_just_after_a_replug_is_held_where_it_is():
    plug = Fault("unplug", at_s=(2.0,), lasts_s=1.0)
    robot = Robot(plug, stops=[(2.5, "freeze"), (8.0, "soft")])
    servo, read = robot.face.chain.servos[1], robot.face.bus.read

    def read_without_it():
        servo.deaf_until_s = math.inf if robot.bridge.state is FaceState.FROZEN else 0.0
        try:
            return read()
        finally:
            servo.deaf_until_s = 0.0

    robot.face.bus.read = read_without_it
    robot.live(10.0)

    held = [places for time_s, _, places in robot.seen if 2.5 < time_s < 7.9]
    assert np.ptp(held, axis=0).max() <= 1.0


def test_a_frozen_servo_that_was_silent_and_holds_after_all_is_looked_after_again():
    robot, found = Robot(stops=[(2.0, "freeze"), (10.0, "soft")]), {}
    servo = robot.face.chain.servos[1]

    def look(name):
        return lambda: found.update({name: (robot.state("joint_2"), servo.torque_on)})

    at = {
        3.0: lambda: servo.ignore_until(4.0),
        3.9: look("silent"),
        5.9: look("heard"),
        6.0: lambda: servo.__setitem__("hardware_error_status", 0x20),
        9.0: look("overloaded"),
    }
    robot.live(12.0, at)

    assert found["silent"] == ("waiting", True)
    assert found["heard"] == ("driven", True)
    assert found["overloaded"] == ("cooling", False)
    assert robot.torque_writes(2.0) == []


def test_what_ails_a_limp_servo_of_a_frozen_face_is_told():
    """Found by the stop campaign: asking whether it holds again and again hid its fault."""
    lost = Fault("torque_lost", servos=(1,), at_s=(1.95,))
    shock = Fault("shock", servos=(1,), at_s=(5.0,))
    plug = Fault("unplug", at_s=(2.0,), lasts_s=1.0)
    robot = Robot(lost, plug, shock, stops=[(2.5, "freeze"), (8.0, "soft")])
    states = {}
    robot.live(60.0, {7.5: lambda: states.update(troubles=robot.bridge.troubles)})

    assert any("electrical shock" in line for line in states["troubles"])


@pytest.mark.parametrize("level", ["soft", "limp"])
def test_a_stopped_face_that_waits_is_started_again_and_only_by_a_person(level):
    plug = Fault("unplug", at_s=(5.0,), lasts_s=1.0)
    robot = Robot(plug, stops=[(2.0, level), (20.0, "soft")], waits=True)
    robot.control.stops[-1] = (20.0, "soft")
    states = {}

    def look():
        states.update(robot.control.status)
        states["stiff"] = robot.stiff

    def start():
        assert robot.say("start")["accepted"] == "start"

    def end():
        robot.control.commands.stop(StopLevel.SOFT, "a test", ends=True)

    robot.live(60.0, {9.9: look, 10.0: start, 30.0: end})

    assert states["state"] == "stopped"
    assert (states["stopped"], states["stopped_by"]) == (level, "a test")
    assert (states["can_start"], states["stop_report"]["complete"]) == (True, True)
    assert states["stiff"] == []
    driven_s = [time_s for time_s, torque, _ in robot.seen if all(torque)]
    limp_s = [time_s for time_s, torque, _ in robot.seen if not any(torque)]
    assert any(12.0 < time_s < 19.0 for time_s in driven_s)
    assert not any(5.0 < time_s < 10.0 or time_s > 24.0 for time_s in driven_s)
    assert any(24.0 < time_s < 30.0 for time_s in limp_s)
    assert robot.face.clock.now() < 33.0
    assert robot.stiff == []


def test_a_frozen_face_goes_on_from_where_it_is_held_and_no_shaft_jumps():
    robot = Robot(stops=[(2.0, "freeze")], waits=True)
    robot.live(9.0, {6.0: lambda: robot.say("start")})

    assert robot.told.stops == [StopLevel.FREEZE, None]
    moved = np.array([places for time_s, _, places in robot.seen if time_s > 6.0])
    held = np.array([places for time_s, _, places in robot.seen if 3.0 < time_s < 6.0])
    assert np.ptp(held, axis=0).max() <= 1.0
    assert np.ptp(moved, axis=0).min() > 50.0  # speech moves it again
    fastest = max(joint.max_speed_deg_s for joint in robot.face.joints)
    steps_deg = np.abs(np.diff(moved, axis=0)) * 360.0 / 4096.0
    assert steps_deg.max() <= 1.1 * fastest / 30.0


def test_a_start_is_refused_while_a_face_is_driven_stopping_or_unplugged():
    plug = Fault("unplug", at_s=(6.0,), lasts_s=2.0)
    robot = Robot(plug, stops=[(3.0, "soft")], waits=True)
    answers = {}

    def ask(name):
        return lambda: answers.update({name: robot.say("start")})

    robot.live(9.0, {2.0: ask("driven"), 3.1: ask("stopping"), 7.0: ask("unplugged")})

    assert "is driven already" in answers["driven"]["error"]
    assert "is stopping" in answers["stopping"]["error"]
    assert "port of the servos is gone" in answers["unplugged"]["error"]


def test_a_start_of_a_face_frozen_on_its_way_to_the_end_is_refused_and_undoes_no_stop():
    robot, answers = Robot(stops=[(2.0, "soft"), (2.1, "freeze"), (6.0, "limp")]), []
    robot.live(60.0, {4.0: lambda: answers.append(robot.say("start"))})

    assert "the next stop ends it" in answers[0]["error"]
    assert robot.told.stops == [StopLevel.SOFT, StopLevel.FREEZE, StopLevel.LIMP]
    assert robot.face.clock.now() < 8.0


def test_a_face_frozen_on_its_way_to_the_end_ends_at_the_first_signal():
    robot, signalled = Robot(stops=[(2.1, "freeze"), (9.0, "limp")]), []
    poll = robot.control.poll

    def poll_and_press():
        if robot.face.clock.now() >= 3.0 and not signalled:
            signalled.append(robot.stiff)
            os.kill(os.getpid(), signal.SIGTERM)
        return poll()

    robot.control.poll = poll_and_press
    robot.live(2.0)

    assert signalled == [[0, 1, 2]]
    assert robot.face.clock.now() < 6.0
    assert robot.stiff == []


def test_a_program_that_ends_undoes_no_freeze():
    robot = Robot(stops=[(2.0, "freeze"), (9.0, "soft")])
    robot.live(4.0)

    assert robot.face.clock.now() > 9.0
    assert robot.stiff == []


def test_a_program_that_ends_with_the_plug_out_waits_half_a_minute_at_most():
    robot = Robot(Fault("unplug", at_s=(2.0,), lasts_s=1000.0))
    robot.live(1000.0, {2.5: robot.life.stop})

    assert 30.0 < robot.face.clock.now() < 35.0


def test_a_frozen_face_keeps_its_watchdogs_from_tripping():
    robot = Robot(stops=[(2.0, "freeze"), (6.0, "limp")])
    tripped = []

    def look():
        tripped.extend(servo["bus_watchdog"] for servo in robot.face.chain.servos)

    robot.live(60.0, {5.9: look})

    assert tripped
    assert all(setting > 0 for setting in tripped)
    places = np.array([places for time_s, _, places in robot.seen if 2.2 < time_s < 6.0])
    assert np.ptp(places, axis=0).max() <= 1.0


def test_a_servo_that_is_deaf_at_the_end_is_not_said_to_be_limp():
    robot = Robot(Fault("silence", servos=(1,), at_s=(2.0,)), stops=[(2.1, "limp")])
    report = robot.live(60.0)

    assert report.confirmed == ("joint_1", "joint_3")
    assert report.unconfirmed == {"joint_2": "does not answer"}
    assert "NOT by 1 servo" in robot.log[-1]


def test_with_the_plug_out_nothing_is_claimed_and_a_signal_waits_no_longer_than_half_a_minute():
    robot = Robot(Fault("unplug", at_s=(2.0,), lasts_s=1000.0))
    report = robot.live(1000.0, {2.5: lambda: os.kill(os.getpid(), signal.SIGTERM)})

    assert not report.confirmed
    assert set(report.unconfirmed.values()) == {"cannot be reached: the port is gone"}
    assert 30.0 < robot.face.clock.now() < 35.0
    assert robot.life.signal_number == signal.SIGTERM


def test_a_second_signal_with_the_plug_out_lets_go_once_it_is_back_in():
    robot = Robot(Fault("unplug", at_s=(2.0,), lasts_s=8.0))
    report = robot.live(60.0, {2.5: interrupt, 2.6: interrupt})

    assert report.complete
    assert robot.stiff == []
    assert 10.0 < robot.face.clock.now() < 12.0


@pytest.mark.parametrize("ended_by_itself", [False, True])
def test_a_third_signal_with_the_plug_out_ends_the_waiting_and_claims_nothing(ended_by_itself):
    robot = Robot(Fault("unplug", at_s=(2.0,), lasts_s=1000.0))
    pressed, end = [], {2.4: robot.life.stop} if ended_by_itself else {}

    def press(line):
        if "one more signal" in line:  # a person reads this
            pressed.append(interrupt())

    robot.on_log = press
    report = robot.live(60.0, {**end, 2.5: interrupt, 2.6: interrupt})

    assert any("the third signal leaves them as they are" in line for line in robot.log)
    assert len(pressed) == 1
    assert not report.confirmed
    assert robot.face.clock.now() < 3.0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
def test_a_first_signal_brings_the_face_to_rest_and_a_second_one_lets_go_at_once(number):
    robot = Robot()
    report = robot.live(60.0, {2.0: lambda: os.kill(os.getpid(), number)})
    assert report.at_rest
    assert report.complete
    assert robot.face.clock.now() < 5.0

    robot = Robot()
    twice = {2.0: lambda: os.kill(os.getpid(), number), 2.05: lambda: os.kill(os.getpid(), number)}
    report = robot.live(60.0, twice)
    assert report.complete
    assert not report.at_rest
    assert robot.face.clock.now() < 2.05 + 0.3


def test_an_error_of_the_program_still_brings_the_face_to_rest():
    robot = Robot()

    def fail():
        raise RuntimeError("a mistake elsewhere")

    with pytest.raises(RuntimeError, match="elsewhere"):
        robot.live(60.0, {2.0: fail})

    assert robot.life.report.at_rest
    assert robot.stiff == []


EVENTS = st.lists(
    st.tuples(
        st.floats(0.5, 6.0),
        st.sampled_from(["soft", "freeze", "limp", "stall", "torque_lost", "reboot", "silence"]),
    ),
    max_size=5,
)


@given(
    plug_s=st.floats(0.5, 5.0),
    out_s=st.floats(0.1, 2.0),
    events=EVENTS,
    last_s=st.floats(1.0, 6.0),
    last=st.sampled_from(["soft", "limp"]),
)
@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_whatever_happened_before_after_a_stop_no_servo_ever_gets_torque(
    plug_s, out_s, events, last_s, last
):
    kinds = ("torque_lost", "reboot", "silence")
    faults = [
        Fault(kind, servos=(1,), at_s=(s,), lasts_s=0.8) for s, kind in events if kind in kinds
    ]
    plug = Fault("unplug", at_s=(plug_s,), lasts_s=out_s)
    stops = [(s, kind) for s, kind in events if kind in set(StopLevel) and s < last_s]
    robot = Robot(plug, *faults, stops=[*stops, (last_s, last)])
    stalls = {s: lambda: robot.face.clock.advance(0.7) for s, kind in events if kind == "stall"}
    report = robot.live(60.0, stalls)

    first_s = min([s for s, _ in stops] + [last_s])
    assert robot.torque_writes(first_s + 0.8) == []
    if report.complete:
        assert robot.stiff == []
    reachable = all(
        servo.deaf_until_s < robot.face.clock.now() - 2.5 for servo in robot.face.chain.servos
    )
    if reachable:
        assert report.complete
