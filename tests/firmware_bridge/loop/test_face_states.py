"""Every state of a face x every event: the state afterwards, and torque on the wire.

The grid is the machine, told a second time by hand: the new state, what became of torque, and +1
where a start is counted. on: every servo gets torque. off: none has any, also where a stranger had
switched it on. off, on: none, then every one. held: who had torque keeps it, and nobody gets any.
unreached: with the port gone all torque is unknown. A dot: the event means nothing; x: nothing can
cause it. Events of which nobody is told are caused as near as a caller can come: the end of a start
in another state by a start that was stopped, and perhaps started again, meanwhile.
"""

import contextlib
from functools import cache

import pytest
from driven_robot import RATE_HZ, TORQUE_ON, speech_deg
from dynamixel_chain import MemoryFace
from state_grid import CANNOT_COME, NOTHING, differences, grid

from firmware_bridge.errors import BusError, ServoError
from firmware_bridge.gate.ramp import StaleRule
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.face_table import FACE_TABLE, FaceEvent, FaceState
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets
from firmware_bridge.stopping import ServoOrder, ServoSwitch, StopLevel

GRID = grid("""
                | stopped             | starting            | driven              | silent            | easing                | frozen            | letting go            | ended
start           | starting, on, +1    | .                   | .                   | .                 | .                     | driven, held, +1  | .                     | .
started         | .                   | driven, on, +1      | .                   | .                 | .                     | .                 | .                     | .
start failed    | .                   | stopped, off        | .                   | .                 | .                     | .                 | .                     | .
keep            | frozen, held        | .                   | .                   | .                 | .                     | .                 | .                     | .
soft stop       | letting go, off     | letting go, off     | easing, held        | letting go, off   | .                     | letting go, off   | .                     | .
soft, unplugged | x                   | x                   | letting go, unreached| x                 | x                     | x                 | x                     | x
freeze          | stopped, held       | frozen, held        | frozen, held        | frozen, held      | frozen, held          | .                 | .                     | .
limp            | letting go, off     | letting go, off     | letting go, off     | letting go, off   | letting go, off       | letting go, off   | .                     | .
targets too old | .                   | .                   | silent, off         | .                 | .                     | .                 | .                     | .
fresh target    | .                   | .                   | .                   | driven, on, +1    | .                     | .                 | .                     | .
at rest         | x                   | x                   | x                   | x                 | letting go, off       | .                 | .                     | x
all off         | .                   | x                   | x                   | .                 | x                     | x                 | ended, off            | x
wait            | .                   | .                   | .                   | .                 | .                     | .                 | .                     | stopped, off
port lost       | stopped, unreached  | starting, unreached | driven, unreached   | silent, unreached | letting go, unreached | frozen, unreached | letting go, unreached | ended, unreached
port back       | stopped, off        | .                   | driven, off, on, +1 | silent, off       | x                     | frozen, held      | letting go, off       | ended, off
""")  # noqa: E501 - a table
N = 3
#: So short that a way to rest, half a second, is longer.
STALE = StaleRule(0.1, 0.2, 0.3)
STOPS = {"soft stop": StopLevel.SOFT, "freeze": StopLevel.FREEZE, "limp": StopLevel.LIMP}
#: A shaft is pushed so far, pulses: farther than it needs to brake.
PUSH = 300.0
#: Where no servo may get torque, whatever speech goes on to say.
STOPPED_STATES = {"stopped", "easing", "frozen", "letting go", "ended"}


class Face:
    """Three servos simulated to the byte and their bridge, in virtual time."""

    def __init__(self, *, tolerant=True):
        self.face = MemoryFace(N, strict=not tolerant)
        self.channel = MemoryTargetChannel()
        settings = BridgeSettings(RATE_HZ, stale=STALE, tolerant=tolerant)
        self.bridge = Bridge(self.face.bus, self.face.joints, self.channel, settings)
        self.tick_s = 0.0
        self.before = self.after = None  # the state, before and after an event

    @property
    def stiff(self):
        return [servo.index for servo in self.face.chain.servos if servo.torque_on]

    def torque_writes(self, since_s):
        return [s for s, data in self.face.written if s > since_s and data[7:11] == TORQUE_ON]

    def tick(self, seconds=0.0, *, speaks=True):
        """Ticks for so long, one at least."""
        end_s = self.face.clock.now() + seconds
        while True:
            self.tick_s = max(self.tick_s + 1.0 / RATE_HZ, self.face.clock.now())
            self.face.clock.sleep_until(self.tick_s)
            if speaks:
                self.channel.publish(ServoTargets(self.tick_s, speech_deg(self.tick_s, N)))
            self.report = self.bridge.tick(self.tick_s)
            if self.face.clock.now() >= end_s:
                return

    def until(self, state, *, speaks=True):
        for _ in range(round(5.0 * RATE_HZ)):
            if self.bridge.state is state:
                return
            self.tick(speaks=speaks)
        raise AssertionError(f"{self.bridge.state}, not {state}")

    def touch(self, index):
        """A stranger switches a servo's torque on."""
        self.face.chain.servos[index].write(bytes((64, 0, 1)))

    def bring(self, state, event=""):
        """Into a state other than STARTING, from STOPPED or from within a start."""
        bridge = self.bridge
        if state is FaceState.STOPPED and bridge.state is state and event == "keep":
            return  # a new process
        if bridge.state is FaceState.STARTING:
            bridge.stop(StopLevel.FREEZE)
        bridge.start()
        self.tick(0.5)
        assert bridge.state is FaceState.DRIVEN
        assert self.stiff == [0, 1, 2]
        if state is FaceState.SILENT:
            self.until(state, speaks=False)
            self.tick(0.2, speaks=False)
        elif state is FaceState.EASING:
            bridge.stop(StopLevel.SOFT)
            self.tick()
        elif state is FaceState.FROZEN:
            bridge.stop(StopLevel.FREEZE)
            self.tick(0.1)
        elif state in (FaceState.LETTING_GO, FaceState.ENDED, FaceState.STOPPED):
            if state is FaceState.LETTING_GO:  # one does not hear it
                self.face.chain.servos[2].ignore_until(self.face.clock.now() + 1.0)
            bridge.stop(StopLevel.LIMP)
            if state is not FaceState.LETTING_GO:
                self.until(FaceState.ENDED)
            if state is FaceState.STOPPED:
                bridge.await_start()
        assert bridge.state is state

    def happen(self, cause):
        """An event, and what it does at once."""
        self.before, self.held_before = self.bridge.state, self.stiff
        self.n_starts, self.at_s = self.bridge.counts.n_armed, self.face.clock.now()
        cause(self)
        self.look()

    def look(self):
        self.after, self.held = self.after or self.bridge.state, self.stiff
        now_s = self.face.clock.now()
        self.deaf = [each.index for each in self.face.chain.servos if each.deaf_until_s > now_s]
        self.n_starts_after = self.bridge.counts.n_armed
        self.said, self.troubles = self.bridge.torque_by_name(), self.bridge.troubles
        self.why_not = self.bridge.refusal(ServoOrder("joint_1", ServoSwitch.REBOOT))
        self.place = self.face.chain.motors.position[0]

    def go_on(self):
        """A few seconds more, of speech too unless it had fallen silent."""
        self.kept = list(self.held)
        if self.bridge.state is FaceState.FROZEN and len(self.kept) > 1:
            # What loses its torque in a stopped face does not get it again.
            self.face.chain.servos[self.kept.pop()].lose_torque()
        if self.bridge.state is FaceState.DRIVEN:  # speech may be a moment late
            self.tick(speaks=False)
            self.first = self.bridge.state
        self.watchdogs = [servo["bus_watchdog"] for servo in self.face.chain.servos]
        self.tick(2.5, speaks=self.bridge.state is not FaceState.SILENT)
        self.at_end = self.stiff


def start(face):
    was_stopped = face.bridge.state is FaceState.STOPPED

    def see():
        face.after = face.bridge.state
        return True

    with contextlib.suppress(ServoError):
        face.bridge.start(see)
    if not was_stopped:
        face.after = face.bridge.state


def lose_port(face):
    face.face.chain.unplug()
    if face.bridge.state is FaceState.STARTING:  # nobody ticks it: an order finds out
        face.bridge.obey(ServoOrder("joint_3", ServoSwitch.REBOOT), face.tick_s)
    else:
        face.tick(speaks=False)
    assert not face.bridge.plugged


def replug(face):
    if face.bridge.state is not FaceState.STARTING:
        face.touch(0)
        face.touch(1)
    face.face.clock.advance(0.4)  # watchdogs trip meanwhile
    face.face.chain.plug_in()
    while not face.bridge.plugged:
        face.tick(speaks=face.bridge.state is not FaceState.SILENT)


def confirm(face):
    for servo in face.face.chain.servos:
        servo.ignore_until(0.0)
    face.tick(speaks=False)
    face.tick(speaks=False)


def arrive(face):
    was = face.bridge.state
    for _ in range(round(0.7 * RATE_HZ)):
        face.tick()
        if face.bridge.state is not was:
            return


CAUSES = {
    "start": start,
    "keep": lambda face: face.bridge.start_frozen(),
    "soft stop": lambda face: face.bridge.stop(StopLevel.SOFT),
    "soft, unplugged": lambda face: face.bridge.stop(StopLevel.SOFT),
    "freeze": lambda face: face.bridge.stop(StopLevel.FREEZE),
    "limp": lambda face: face.bridge.stop(StopLevel.LIMP),
    "targets too old": lambda face: face.tick(0.35, speaks=False),
    "fresh target": lambda face: face.tick(),
    "at rest": arrive,
    "all off": confirm,
    "wait": lambda face: face.bridge.await_start(),
    "port lost": lose_port,
    "port back": replug,
}
#: Events of a start's end, and what a start is told that it ends so.
ENDS_OF_START = {"started": True, "start failed": False}


def play(state, event):
    """A face in which an event happened in a state, at once, and three seconds later."""
    strict = state is FaceState.STARTING and event not in ENDS_OF_START
    face = Face(tolerant=not strict)
    with face.face.bus:
        if event in ENDS_OF_START:
            end_a_start(face, state, event)
        elif state is FaceState.STARTING:
            happen_in_a_start(face, event)
        elif state is FaceState.ENDED and event.startswith("port"):
            lose_port_with_the_last_word(face)
            if event == "port back":
                face.after = None
                face.happen(replug)
        else:
            came_from_rest = event == "at rest" and state is not FaceState.EASING
            face.bring(FaceState.EASING if came_from_rest else state, event)
            if came_from_rest:
                face.face.chain.servos[2].ignore_until(face.face.clock.now() + 1.0)
                face.bridge.stop(StopLevel.FREEZE if state is FaceState.FROZEN else StopLevel.LIMP)
            prepare(face, state, event)
            face.happen(CAUSES[event])
        assert face.before is state
        face.go_on()
    return face


def prepare(face, state, event):
    """What shows that an action is done: torque by a stranger's hand, a shaft pushed away."""
    if event in ("port back", "soft, unplugged"):
        lose_port(face)
    if event in ("soft stop", "limp") and state in (FaceState.STOPPED, FaceState.SILENT):
        face.touch(1)
    if event == "keep" and state is FaceState.STOPPED:
        face.touch(0)
        face.touch(1)
    if event == "start" and state is FaceState.FROZEN:
        face.face.chain.servos[2].lose_torque()
        face.tick(0.4, speaks=False)
    if event == "freeze":
        face.face.chain.motors.position[0] += PUSH


def end_a_start(face, state, event):
    @cache  # asked again and again
    def bring_in():
        if state is not FaceState.STARTING:
            face.bring(state)
        else:
            face.face.clock.advance(0.4)
            face.touch(1)
        face.happen(lambda _face: None)
        face.after = None
        return ENDS_OF_START[event]

    face.bridge.start(bring_in)
    face.look()


def happen_in_a_start(face, event):
    """When the first of three servos is armed."""

    def may_continue():
        if face.before is None and face.stiff:
            prepare(face, FaceState.STARTING, event)
            face.happen(CAUSES[event])
        return face.bridge.state is FaceState.STARTING

    with contextlib.suppress(BusError):
        face.bridge.start(may_continue)


def lose_port_with_the_last_word(face):
    """In the tick in which the last servo confirms; later nothing is sent any more."""
    face.bring(FaceState.LETTING_GO)
    bus, look_after = face.face.bus, face.face.bus.look_after

    def cut():
        if face.bridge.state is FaceState.ENDED and face.bridge.plugged:
            face.happen(lambda _face: face.face.chain.unplug())
        return look_after()

    bus.look_after = cut
    face.face.chain.servos[2].ignore_until(0.0)
    face.until(FaceState.ENDED)
    face.look()


def test_the_grid_and_the_table_have_the_same_cells():
    cells = {key: cell for key, cell in GRID.items() if key[1] != "soft, unplugged"}
    assert differences(FACE_TABLE, cells, FaceState, FaceEvent) == []


@pytest.mark.parametrize(("state", "event"), GRID)
def test_in_every_state_an_event_does_what_the_grid_says_and_no_more(state, event):
    cell = GRID[state, event]
    if cell == CANNOT_COME:
        return
    face = play(FaceState(state), event)
    then, *does = [state, "held"] if cell == NOTHING else cell.split(", ")
    number = {name: index for index, name in enumerate(face.bridge.names)}
    at_end = face.at_end

    assert face.after == then
    assert face.n_starts_after - face.n_starts == does.count("+1")
    # What is said of torque is so.
    assert {number[each] for each in face.said["holds"]} <= set(face.held)
    assert {number[each] for each in face.said["limp"]}.isdisjoint(face.held)
    if "unreached" in does:
        assert len(face.said["unknown"]) == len(face.troubles) == N
        assert all("the port is gone" in line for line in face.troubles)
    if "held" in does:
        assert face.held == face.held_before
    if "off" in does:
        n_armed = does.count("on")  # by the tick that finds the port back
        assert len(set(face.held) - set(face.deaf)) <= n_armed
    if then == FaceState.DRIVEN:
        assert face.first == then
    if then == FaceState.DRIVEN or "on" in does:
        assert at_end == [0, 1, 2]
    if "off" in does and "on" not in does:
        assert at_end == []
    if event in STOPS and cell != NOTHING:
        assert f"stopped by a person ({STOPS[event].value})" in face.why_not
    if then in STOPPED_STATES and "on" not in does:
        assert set(at_end) <= set(face.kept)
        assert face.torque_writes(face.at_s) == []
    if then == FaceState.FROZEN and cell != "frozen, unreached":
        assert at_end == face.kept
        assert all(face.watchdogs[index] == 5 for index in face.kept)  # none has tripped
    if (
        event == "freeze" and cell != NOTHING and 0 in face.kept
    ):  # held where it is, not where it was told to go
        assert abs(face.face.chain.motors.position[0] - face.place) < PUSH / 2
