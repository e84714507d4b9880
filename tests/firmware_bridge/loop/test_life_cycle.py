"""A stop by a person holds, whatever happens to plug, servos and speech; what is said is true."""

import os
import signal

import numpy as np
import pytest
from dynamixel_chain import MemoryFace, mounted
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from firmware_bridge.bus import ServoError
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.channel import MemoryTargetChannel
from firmware_bridge.loop.life_cycle import LifeCycle
from firmware_bridge.loop.report import FaceState
from firmware_bridge.simulator.faults import Fault
from firmware_bridge.stopping import StopLevel
from firmware_bridge.targets import ServoTargets

RATE_HZ = 30.0
#: Instruction write, address 64, value 1.
TORQUE_ON = bytes((3, 64, 0, 1))


def interrupt():
    """Ctrl-C, once."""
    os.kill(os.getpid(), signal.SIGINT)


class Asked:
    """A control socket in memory: stops by their moments, in seconds; what it was told last."""

    def __init__(self, clock, stops):
        self.clock, self.stops, self.end = clock, sorted(stops), None

    def poll(self, status):
        assert "state" in status()
        if self.stops and self.stops[0][0] <= self.clock.now():
            return StopLevel(self.stops.pop(0)[1])
        return None

    def report_end(self, report):
        self.end = report


class Told:
    """A supervisor's end of the lifeline."""

    def __init__(self):
        self.n_beats, self.stops, self.failures = 0, [], {}

    def beat(self):
        self.n_beats += 1

    def stopped(self, level):
        self.stops.append(level)

    def failed(self, index, reason):
        self.failures[index] = reason


class Robot:
    """Servos simulated to the byte, spoken to without end, on a life cycle in virtual time."""

    def __init__(self, *faults, stops=(), n=3, servos=None, tolerant=True, **options):
        self.face = MemoryFace(n, servos=servos, faults=faults, strict=not tolerant)
        self.channel = MemoryTargetChannel()
        self.bridge = Bridge(
            self.face.bus,
            self.face.joints,
            self.channel,
            rate_hz=RATE_HZ,
            tolerant=tolerant,
            **options,
        )
        self.control, self.told = Asked(self.face.clock, stops), Told()
        self.log = []
        self.life = LifeCycle(
            self.bridge,
            self.face.clock,
            rate_hz=RATE_HZ,
            control=self.control,
            lifeline=self.told,
            log=self.note,
            status=lambda: {"state": self.bridge.state.value},
        )
        self.on_log = lambda _line: None
        #: (time, torque of each servo, position of each) after every tick.
        self.seen = []

    def note(self, line):
        self.log.append(line)
        self.on_log(line)

    def live(self, until_s, at=None):
        """From start to end; `at`: what happens at a moment, by its time."""
        at = dict(at or {})
        with self.face.bus, self.life as life:
            life.start()
            for time_s, late in life.ticks():
                for moment_s in [m for m in at if m <= time_s]:
                    at.pop(moment_s)()
                if time_s > until_s:
                    break
                goal_deg = 15.0 * np.sin(2.0 * np.pi * time_s + np.arange(len(self.face.servos)))
                self.channel.publish(ServoTargets(time_s, goal_deg))
                self.bridge.tick(time_s, late)
                torque = [servo.torque_on for servo in self.face.chain.servos]
                self.seen.append((time_s, torque, self.face.chain.motors.position.copy()))
        return life.report

    @property
    def stiff(self):
        return [servo.index for servo in self.face.chain.servos if servo.torque_on]

    def torque_writes(self, since_s):
        """Writes of 1 to torque_enable after `since_s`, on the wire."""
        return [s for s, data in self.face.written if s > since_s and data[7:11] == TORQUE_ON]


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


def test_a_third_signal_with_the_plug_out_ends_the_waiting_and_claims_nothing():
    robot = Robot(Fault("unplug", at_s=(2.0,), lasts_s=1000.0))
    pressed = []

    def press(line):
        if "one more signal" in line:  # a person reads this
            pressed.append(interrupt())

    robot.on_log = press
    report = robot.live(60.0, {2.5: interrupt, 2.6: interrupt})

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


def test_a_servo_given_up_is_not_switched_on_again_by_a_replug_or_a_silence():
    def jam(robot):
        robot.face.chain.motors.jammed[1] = True
        robot.face.chain.motors.position[1] += 400.0

    unplug = Fault("unplug", at_s=(30.0,), lasts_s=1.0)
    robot = Robot(unplug, stops=[(40.0, "soft")])
    given_up = {}
    robot.live(
        60.0,
        {
            2.0: lambda: jam(robot),
            29.0: lambda: given_up.update(robot.bridge.given_up),
        },
    )

    assert "does not follow" in given_up[1]
    assert robot.told.failures == given_up
    assert not any(torque[1] for time_s, torque, _ in robot.seen if time_s > 29.0)
    assert all(torque[0] for time_s, torque, _ in robot.seen if 33.0 < time_s < 39.5)


def test_a_servo_given_up_by_an_earlier_process_stays_limp():
    robot = Robot(stops=[(4.0, "soft")], given_up={2: "does not follow"})
    robot.live(60.0)

    assert not any(torque[2] for _, torque, _ in robot.seen)
    assert any(torque[0] for _, torque, _ in robot.seen)


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
    robot = Robot(Fault("silence", servos=(0,), at_s=(2.0,), lasts_s=2.0), stops=[(8.0, "soft")])
    found = {}

    def exchange():
        servo = robot.face.chain.servos[0]
        servo.reboot(robot.face.clock.now())
        servo[register] = value

    robot.live(60.0, {3.0: exchange, 7.5: lambda: found.update(troubles=robot.bridge.troubles)})

    assert not any(torque[0] for time_s, torque, _ in robot.seen if time_s > 3.1)
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

    with pytest.raises(ServoError, match=r"critical servo 'joint_2' .* all is limp"):
        robot.live(120.0, {2.0: jam})

    assert robot.stiff == []
    assert robot.bridge.state is FaceState.ENDED


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
