"""A neck that says everything and lips that say nothing, on a bus each, driven as one face."""

import threading
from types import SimpleNamespace

import numpy as np
import pytest
from hobby_bus import PULSES, WORDS

from firmware_bridge.capabilities import IN_MEMORY, ONE_LOST, mixed_capabilities
from firmware_bridge.clock import ManualClock
from firmware_bridge.errors import PortError, PortGone, ServoError
from firmware_bridge.joints import Joint
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.face_table import FaceState
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets
from firmware_bridge.several_buses import SeveralBuses
from firmware_bridge.simulator.bus import SimulatedBus
from firmware_bridge.stopping import ServoOrder, ServoSwitch, StopLevel

RATE_HZ = 50.0
#: Of the buses: a computer that is busy may be late by a part of it.
SLOW_HZ = 4.0
#: Far more than any thread here takes.
PATIENCE_S = 30.0
JOINTS = [
    Joint("jaw", 0, -5.0, 25.0, 300.0),
    Joint("yaw", 0, -60.0, 60.0, 120.0),
    Joint("lip", 1, -10.0, 10.0, 300.0),
    Joint("pitch", 1, -20.0, 20.0, 120.0),
]
BUS_OF = ("lips", "neck", "lips", "neck")
LIPS, NECK = [0, 2], [1, 3]
GOAL_DEG = np.array([12.0, 30.0, -6.0, -10.0])


class FaultyBus(SimulatedBus):
    """Stands still while `may_go` is not set, and loses its port while `plugged` is False."""

    is_jammed = False
    #: What it was asked to do, in turns.
    done: tuple[str, ...] = ()

    def __init__(self, joints, clock, capabilities):
        super().__init__(joints, clock, capabilities=capabilities)
        self.may_go, self.plugged, self.error = threading.Event(), True, None
        self.may_go.set()
        self.n_enabled = 0

    def _move(self):
        before_deg = self._positions_deg
        super()._move()
        if self.is_jammed:
            self._positions_deg = before_deg

    def _meet(self):
        assert self.may_go.wait(PATIENCE_S)
        if not self.plugged:
            raise PortGone("/dev/x: gone; plug the adapter in again")
        if self.error is not None:
            raise self.error

    def write_positions(self, positions_deg):
        self.done += ("write",)
        self._meet()
        super().write_positions(positions_deg)

    def feedback(self):
        self._meet()
        return super().feedback()

    def enable_torque(self, index):
        self._meet()
        self.n_enabled += 1
        return super().enable_torque(index)

    def disable_torque(self, index):
        self._meet()
        return super().disable_torque(index)

    def disable_all(self):
        self.done += ("off",)
        self._meet()
        return super().disable_all()

    def reopen(self):
        self._meet()

    @property
    def is_held(self):
        return self._torque_on.tolist()


@pytest.fixture
def face():
    clock, channel = ManualClock(), MemoryTargetChannel()
    lips = FaultyBus([JOINTS[n] for n in LIPS], clock, PULSES)
    neck = FaultyBus([JOINTS[n] for n in NECK], clock, IN_MEMORY)
    bus = SeveralBuses({"lips": lips, "neck": neck}, BUS_OF, clock, SLOW_HZ)
    bridge = Bridge(bus, JOINTS, channel, BridgeSettings(RATE_HZ))
    with bus:
        yield SimpleNamespace(
            clock=clock, channel=channel, bus=bus, bridge=bridge, lips=lips, neck=neck
        )
        for each in (lips, neck):
            each.plugged, each.error = True, None
            each.may_go.set()


def drive(face, n, goal_deg=GOAL_DEG):
    for _ in range(n):
        time_s = face.clock.now() + 1.0 / RATE_HZ
        face.clock.sleep_until(time_s)
        face.channel.publish(ServoTargets(time_s, goal_deg))
        face.bridge.tick(time_s)


def drive_until(face, condition, most=2000):
    for _ in range(most):
        if condition():
            return
        drive(face, 1)
    raise AssertionError("it never came true")


def servos(face):
    return face.bridge.as_dict()["servos"]


def all_driven(face):
    return set(servos(face).values()) == {"driven"}


def test_every_servo_goes_to_its_goal_on_its_own_bus(face):
    face.bridge.start()
    drive(face, 200)

    assert face.bridge.troubles == ()
    np.testing.assert_allclose(face.lips.history[-1].positions_deg, GOAL_DEG[LIPS], atol=0.1)
    np.testing.assert_allclose(face.neck.history[-1].positions_deg, GOAL_DEG[NECK], atol=0.1)


def test_a_bus_that_says_nothing_yet_in_the_first_ticks_is_not_taken_for_hot():
    clock, channel = ManualClock(), MemoryTargetChannel()
    lips, neck = (FaultyBus([JOINTS[n] for n in at], clock, IN_MEMORY) for at in (LIPS, NECK))
    bus = SeveralBuses({"lips": lips, "neck": neck}, BUS_OF, clock, SLOW_HZ)
    bridge = Bridge(bus, JOINTS, channel, BridgeSettings(RATE_HZ))
    face = SimpleNamespace(clock=clock, channel=channel, bridge=bridge)
    with bus:
        bridge.start()
        neck.may_go.clear()
        drive(face, 5)
        neck.may_go.set()
        drive(face, 300)

        assert bridge.as_dict()["rejected_total"] == 0
        np.testing.assert_allclose(neck.history[-1].positions_deg, GOAL_DEG[NECK], atol=0.1)


def test_places_are_those_of_the_servos_that_know_them(face):
    face.bridge.start()
    drive(face, 200)
    places_deg = face.bus.feedback().positions_deg
    np.testing.assert_array_equal(face.bus.read().positions_deg, places_deg)
    health = face.bridge.as_dict()["health"]

    np.testing.assert_allclose(places_deg[NECK], GOAL_DEG[NECK], atol=0.1)
    assert np.isnan(places_deg[LIPS]).all()
    assert [each["temperature_degc"] for each in health] == [None, 25.0, None, 25.0]


def test_before_it_is_opened_nothing_is_known_of_torque(face):
    buses = {"lips": face.lips, "neck": face.neck}

    assert SeveralBuses(buses, BUS_OF, face.clock, SLOW_HZ).torque.any_on is None


def test_limits_widen_on_the_bus_of_each_joint(face):
    reached = {}
    face.lips.widen = lambda joints: reached.update(lips=joints.tolist())
    face.neck.widen = lambda joints: reached.update(neck=joints.tolist())
    face.bus.widen(np.array([True, False, False, True]))
    drive_until(face, lambda: len(reached) == 2)

    assert reached == {"lips": [True, False], "neck": [False, True]}


def test_a_port_that_goes_while_places_are_read_is_no_reading(face):
    def gone():
        raise PortGone("/dev/x: gone; plug the adapter in again")

    face.lips.read = gone
    with pytest.raises(PortError, match="/dev/x: gone"):
        face.bus.read()


def test_what_a_bus_said_within_a_tick_is_no_older_than_on_a_bus_alone(face):
    face.bridge.start()
    drive(face, 5)
    face.lips.may_go.clear()
    face.clock.advance(0.5 / SLOW_HZ)
    assert (face.bus.feedback().age_s[LIPS] == 0.0).all()

    face.clock.advance(1.0 / SLOW_HZ)
    assert (face.bus.feedback().age_s[LIPS] == 1.5 / SLOW_HZ).all()


def test_a_bus_that_stalls_delays_no_other_and_sends_its_newest_goal_afterwards(face):
    face.bridge.start()
    drive(face, 100)
    face.lips.may_go.clear()
    n_lips, n_neck = len(face.lips.history), len(face.neck.history)
    goals_deg = np.linspace(30.0, 50.0, 100)
    for goal_deg in goals_deg:
        drive(face, 1, np.array([0.0, goal_deg, 0.0, 0.0]))
    sent_deg = [each.goals_deg[0] for each in face.neck.history[n_neck:]]

    assert len(sent_deg) >= 95
    assert sent_deg == sorted(sent_deg)
    assert len(face.lips.history) == n_lips

    face.lips.may_go.set()
    drive_until(face, lambda: all_driven(face))
    drive(face, 20, np.array([3.0, 50.0, 2.0, 0.0]))
    np.testing.assert_allclose(face.lips.history[-1].goals_deg, [3.0, 2.0], atol=0.1)
    assert len(face.lips.history) - n_lips < 60  # not a hundred goals of before


def test_the_servos_of_a_bus_that_stalls_are_said_not_to_answer_and_come_back(face):
    face.bridge.start()
    drive(face, 50)
    face.neck.may_go.clear()
    drive(face, 100)

    assert servos(face) == {"jaw": "driven", "yaw": "waiting", "lip": "driven", "pitch": "waiting"}
    assert set(face.bridge.troubles) == {
        "servo 'yaw' (id 0) does not answer", "servo 'pitch' (id 1) does not answer",
    }  # fmt: skip
    ages_s = face.bridge.feedback.age_s
    assert ages_s[NECK].min() > 1.5
    assert not ages_s[LIPS].any()

    face.neck.may_go.set()
    drive_until(face, lambda: all_driven(face))


def test_a_port_that_is_lost_lets_go_of_the_others_and_the_face_comes_back_when_it_does(face):
    face.bridge.start()
    drive(face, 50)
    face.lips.plugged = False
    drive_until(face, lambda: not face.bridge.plugged)

    assert face.neck.is_held == [False, False]
    assert face.bridge.troubles == (
        "servo 'jaw' (id 0) cannot be reached: the port is gone",
        "servo 'yaw' (id 0) limp: a port of the face is gone",
        "servo 'lip' (id 1) cannot be reached: the port is gone",
        "servo 'pitch' (id 1) limp: a port of the face is gone",
    )
    assert "bus lips: /dev/x: gone; plug the adapter in again" in face.bus.remarks()
    drive(face, 100)
    assert face.neck.is_held == [False, False]

    face.lips.plugged = True
    drive_until(face, lambda: all_driven(face))
    assert face.neck.is_held == face.lips.is_held == [True, True]
    assert face.bridge.plugged


def test_a_frozen_face_goes_on_holding_when_one_port_is_lost_until_it_is_stopped(face):
    face.bridge.start()
    drive(face, 100)
    face.bridge.stop(StopLevel.FREEZE)
    face.lips.plugged = False
    drive_until(face, lambda: not face.bridge.plugged)
    drive(face, 50)

    assert face.neck.is_held == [True, True]

    face.bridge.stop(StopLevel.LIMP)
    assert face.neck.is_held == [False, False]
    report = face.bridge.stop_report()
    assert report.confirmed == ("yaw", "pitch")
    assert report.unconfirmed == dict.fromkeys(
        ("jaw", "lip"), "cannot be reached: the port is gone"
    )

    face.lips.plugged = True
    drive_until(face, lambda: face.bridge.state is FaceState.ENDED)
    assert face.bridge.stop_report().complete
    assert face.lips.is_held == [False, False]


@pytest.mark.parametrize(("back", "gone"), [("lips", "neck"), ("neck", "lips")])
def test_of_two_ports_lost_at_once_the_one_that_comes_back_is_let_go(face, back, gone):
    face.bridge.start()
    drive(face, 50)
    face.lips.plugged = face.neck.plugged = False
    drive(face, 50)
    assert not any("limp:" in line for line in face.bridge.troubles)

    getattr(face, back).plugged = True
    drive_until(face, lambda: getattr(face, back).is_held == [False, False])
    drive(face, 2)
    returned = [JOINTS[n].name for n in (LIPS if back == "lips" else NECK)]
    assert [name for name in returned for line in face.bridge.troubles if name in line] == returned
    assert sum("limp: a port of the face is gone" in line for line in face.bridge.troubles) == 2
    assert not face.bridge.plugged

    getattr(face, gone).plugged = True
    drive_until(face, lambda: all_driven(face))


def test_what_a_frozen_face_holds_at_its_other_port_is_said_to_be_held_and_is_switched_off(face):
    face.bridge.start()
    drive(face, 100)
    face.bridge.stop(StopLevel.FREEZE)
    face.lips.plugged = False
    drive_until(face, lambda: not face.bridge.plugged)
    held = "held: a port of the face is gone"
    assert face.bridge.troubles[1::2] == (
        f"servo 'yaw' (id 0) {held}",
        f"servo 'pitch' (id 1) {held}",
    )

    for name in ("jaw", "yaw"):  # what cannot be reached keeps no other on
        assert not face.bridge.obey(ServoOrder(name, ServoSwitch.OFF), face.clock.now())
    drive_until(face, lambda: servos(face)["yaw"] == "off")
    assert face.neck.is_held == [False, True]


@pytest.mark.parametrize(("hung", "reached"), [("lips", "neck"), ("neck", "lips")])
def test_a_stop_while_one_bus_hangs_lets_the_other_go_and_names_the_rest(face, hung, reached):
    face.bridge.start()
    drive(face, 100)
    getattr(face, hung).may_go.clear()
    drive(face, 3)
    face.bridge.stop(StopLevel.LIMP)

    assert getattr(face, reached).is_held == [False, False]
    drive_until(face, lambda: face.bridge.state is FaceState.ENDED)
    report = face.bridge.stop_report()
    left = [JOINTS[n].name for n in (LIPS if hung == "lips" else NECK)]
    assert report.unconfirmed == dict.fromkeys(left, "does not answer")
    assert not report.complete

    getattr(face, hung).may_go.set()
    face.bus.disable_all()
    drive_until(face, lambda: getattr(face, hung).is_held == [False, False])


def test_a_stop_says_of_each_servo_what_its_bus_can_know(face):
    face.bridge.start()
    drive(face, 100)
    face.bridge.stop(StopLevel.LIMP)
    drive_until(face, lambda: face.bridge.state is FaceState.ENDED)
    report = face.bridge.stop_report()

    assert (report.confirmed, report.released) == (("yaw", "pitch"), ("jaw", "lip"))
    assert report.text() == (
        f"stopped; 2 servos let go, not confirmed: {WORDS}; torque off confirmed by 2 servos"
    )


def test_torque_is_never_switched_on_later_than_it_was_asked_for(face):
    face.lips.may_go.clear()
    face.bus.write_positions(np.zeros(4))
    assert face.bus.enable_torque(0) == "has not confirmed yet: its bus is busy"
    face.lips.may_go.set()
    face.bus.read()

    assert face.lips.n_enabled == 0
    assert face.lips.is_held == [False, False]


def test_a_servo_that_was_let_go_and_holds_again_does_not_count_as_let_go(face):
    face.bridge.start()
    assert face.bus.disable_all().all()
    assert not face.bus.enable_torque(1)
    assert face.neck.is_held == [True, False]
    assert face.bus.disable_torque(1)
    assert face.neck.is_held == [False, False]


def test_a_servo_that_comes_on_by_itself_after_it_was_let_go_is_let_go_again(face):
    face.bridge.start()
    assert face.bus.disable_all().all()
    SimulatedBus.enable_torque(face.neck, 0)
    assert face.neck.is_held == [True, False]
    assert face.bus.disable_torque(1)
    assert face.neck.is_held == [False, False]


def test_a_servo_that_a_person_tries_again_is_forgiven_even_if_all_are_let_go_before(face):
    forgiven = []
    face.neck.forgive = forgiven.append
    face.bridge.start()
    drive(face, 20)
    face.bridge.obey(ServoOrder("pitch", ServoSwitch.OFF), face.clock.now())
    drive_until(face, lambda: servos(face)["pitch"] == "off")
    face.bridge.obey(ServoOrder("pitch", ServoSwitch.ON), face.clock.now())
    drive_until(face, lambda: all_driven(face))
    assert forgiven == [1]
    face.neck.may_go.clear()
    drive(face, 3)
    face.bus.forgive(3)
    face.bus.disable_all()
    face.neck.may_go.set()
    drive_until(face, lambda: forgiven == [1, 1])


def test_a_bus_that_hangs_for_good_counts_as_lost(face):
    face.bridge.start()
    drive(face, 50)
    face.neck.may_go.clear()
    drive_until(face, lambda: not face.bridge.plugged)

    assert face.lips.is_held == [False, False]
    assert "bus neck: has stood still for 5 s" in face.bus.remarks()

    face.neck.may_go.set()
    drive_until(face, lambda: all_driven(face))


def test_torque_off_goes_before_all_that_was_handed_over(face):
    face.bridge.start()
    drive(face, 20)
    face.lips.may_go.clear()
    drive(face, 3)
    face.lips.done = ()
    assert not face.bus.disable_all()[LIPS].any()
    face.bus.write_positions(np.zeros(4))
    face.lips.may_go.set()
    drive_until(face, lambda: "off" in face.lips.done)

    assert face.lips.done[0] == "off"


def test_an_answer_from_before_torque_off_is_not_believed_after_it(face):
    slow, told = threading.Event(), threading.Event()
    enable = SimulatedBus.enable_torque

    def enable_torque(index):
        told.set()
        slow.wait(PATIENCE_S)
        return enable(face.lips, index)

    face.lips.enable_torque = enable_torque
    assert "busy" in face.bus.enable_torque(2)
    assert told.is_set()
    face.bus.disable_all()
    slow.set()
    while not face.bus.disable_torque(2):
        pass
    assert face.lips.is_held == [False, False]

    told.clear()
    while "busy" in face.bus.enable_torque(2):
        pass
    assert told.is_set()
    assert face.lips.is_held == [False, True]


def test_torque_of_a_bus_that_is_lost_is_unknown_and_of_the_others_as_they_say(face):
    face.bridge.start()
    drive_until(face, lambda: face.bus.torque.as_json() == [True] * 4)
    face.lips.plugged = False
    drive_until(face, lambda: not face.bridge.plugged)

    assert face.bus.torque.as_json() == [None, False, None, False]
    face.lips.plugged = True
    drive_until(face, lambda: face.bus.torque.as_json() == [True] * 4)


def test_torque_of_a_bus_that_is_mute_is_unknown_after_half_a_second(face):
    face.bridge.start()
    drive_until(face, lambda: face.bus.torque.as_json() == [True] * 4)
    face.neck.may_go.clear()
    drive(face, 5)
    assert face.bus.torque.as_json() == [True] * 4
    drive(face, 30)

    assert face.bus.torque.as_json() == [True, None, True, None]
    assert face.bus.look_after().torque.tolist() == [1, 2, 1, 2]
    face.neck.may_go.set()
    drive_until(face, lambda: face.bus.torque.as_json() == [True] * 4)


def test_a_program_that_stood_still_itself_takes_no_bus_for_hung(face):
    face.bridge.start()
    drive(face, 50)
    face.neck.may_go.clear()
    drive(face, 10)
    face.clock.advance(60.0)
    drive(face, 10)
    assert face.bridge.plugged

    face.neck.may_go.set()
    drive_until(face, lambda: all_driven(face))
    assert not any("stood still" in each for each in face.bus.remarks())


def test_of_three_buses_one_that_is_mute_is_said_to_be_and_the_others_go_on():
    clock, channel = ManualClock(), MemoryTargetChannel()
    joints = [Joint(f"j{n}", n, -60.0, 60.0, 120.0) for n in range(3)]
    buses = {name: FaultyBus([joint], clock, IN_MEMORY) for name, joint in zip("abc", joints)}  # noqa: B905
    bus = SeveralBuses(buses, tuple("abc"), clock, SLOW_HZ)
    bridge = Bridge(bus, joints, channel, BridgeSettings(RATE_HZ))
    three = SimpleNamespace(clock=clock, channel=channel, bridge=bridge)
    with bus:
        bridge.start()
        drive(three, 20, np.zeros(3))
        buses["b"].may_go.clear()
        drive(three, 100, np.full(3, 30.0))

        assert bus.remarks() == ["bus b: no servo answers; the other buses go on"]
        assert bus.torque.as_json() == [True, None, True]
        for name in "ac":
            np.testing.assert_allclose(buses[name].history[-1].positions_deg, 30.0, atol=0.1)
        buses["b"].may_go.set()


def test_what_a_bus_raises_that_is_no_matter_of_its_port_is_raised_in_the_tick(face):
    face.neck.error = ServoError("something else")
    with pytest.raises(ServoError, match="something else"):
        face.bus.feedback()


def test_a_bus_that_cannot_be_opened_is_named_and_the_others_are_closed_again():
    clock = ManualClock()
    lips = FaultyBus([JOINTS[n] for n in LIPS], clock, PULSES)

    class Absent(SimulatedBus):
        def __enter__(self):
            raise PortError("/dev/y: no such port")

    neck = Absent([JOINTS[n] for n in NECK], clock)
    bus = SeveralBuses({"lips": lips, "neck": neck}, BUS_OF, clock, SLOW_HZ)
    with pytest.raises(PortError, match="bus neck: /dev/y: no such port"), bus:
        pass
    with pytest.raises(PortError, match="outside its `with` block"):
        lips.read()


def test_what_all_servos_can_is_claimed_of_the_face_and_what_one_can_of_it_alone():
    can = mixed_capabilities({"lips": PULSES, "neck": IN_MEMORY}, BUS_OF)

    assert (can.place, can.confirmed_limp, can.hold) == (False, False, True)
    assert (can.of(0), can.of(1)) == (PULSES, IN_MEMORY)
    assert can.pulse_rate_hz == 50.0
    assert can.released_words == f"lips: {WORDS}; neck: limp"
    assert can.warnings()[0].startswith("lips: stop: to neutral; then pulses off")
    assert can.warnings()[-1] == ONE_LOST


def test_a_servo_that_does_not_follow_is_let_go_while_one_that_cannot_say_so_is_not(face):
    face.bridge.start()
    drive(face, 100)
    face.neck.is_jammed = True
    for _ in range(200):
        drive(face, 1, np.array([20.0, -30.0, 8.0, -10.0]))
        if servos(face)["yaw"] != "driven":
            break

    assert servos(face) == {"jaw": "driven", "yaw": "cooling", "lip": "driven", "pitch": "driven"}
    assert "jammed or weak" in face.bridge.troubles[0]
