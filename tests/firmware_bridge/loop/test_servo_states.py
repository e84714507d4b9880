"""Every state of one servo x every event, on servos simulated to the byte: its state then, torque.

The grid is the machine, told a second time by hand. In a cell: the new state, and what is done: off
(its torque goes off), on (it comes on), again (it is restarted). A dot: the event means nothing; x:
nothing can cause it, or tell it from another. Behind an event stands how often it had come before:
of a servo that does not follow the fourth time test_servo_supervision.py tells, since one that is
jammed in the simulator has an overload first.
What follows at once has no moment of its own: a servo that is ready is driven as soon as it has
confirmed, and one that is switched off is off as soon as it has.
"""

import pytest
from driven_robot import RATE_HZ, speech_deg
from dynamixel_chain import MemoryFace
from state_grid import CANNOT_COME, NOTHING, differences, grid

from firmware_bridge.bus import ServoState
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.servo_table import SERVO_TABLE, ServoEvent
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets
from firmware_bridge.simulator.motors import SHOCK_ERROR
from firmware_bridge.stopping import ServoOrder, ServoSwitch

GRID = grid("""
                       | driven             | waiting          | cooling          | rebooting        | failed          | switching off        | off
silent                 | waiting            | waiting          | .                | waiting          | .               | .                    | .
hardware error         | cooling, off       | cooling          | .                | cooling          | .               | x                    | .
too hot                | cooling, off       | x                | .                | x                | .               | .                    | .
does not follow        | cooling, off       | x                | x                | x                | x               | x                    | x
does not follow, often | x failed, off      | x                | x                | x                | x               | x                    | x
watchdog tripped       | waiting, on        | x                | x                | x                | .               | x                    | .
torque lost            | waiting, on        | x                | x                | x                | x               | x                    | x
still on               | x                  | x                | cooling, off     | x                | failed, off     | x                    | off, off
cooled down            | x                  | x                | waiting, on      | x                | x               | x                    | x
error stays            | x                  | x                | rebooting, again | x                | x               | x                    | x
error stays, often     | x                  | x                | failed           | x                | x               | x                    | x
ready                  | x                  | driven, on       | x                | driven, on       | .               | x                    | .
due                    | x                  | x                | x                | x                | x               | off, off             | x
enabled                | x driven           | driven, on       | x driven         | driven, on       | driven, on      | x                    | x
refused                | x waiting          | waiting          | x waiting        | waiting          | x               | x                    | x
confirmed off          | x                  | x                | x                | x                | x               | off, off             | x
all off                | waiting            | waiting          | waiting          | waiting          | .               | switching off        | switching off
servo off              | switching off, off | switching off    | switching off    | switching off    | switching off   | switching off        | switching off
servo on               | .                  | .                | .                | .                | waiting, on     | waiting              | waiting, on
servo reboot           | .                  | rebooting, again | rebooting, again | rebooting, again | failed, again   | switching off, again | switching off, again
""")  # noqa: E501 - a table
SUBJECT = 1
NAME = "joint_2"
ORDERS = {
    "servo off": ServoSwitch.OFF,
    "servo on": ServoSwitch.ON,
    "servo reboot": ServoSwitch.REBOOT,
}
#: Restarts, or tries of one that is jammed, before a servo is given up.
TRIES = 3


def word(state):
    return state.name.lower().replace("_", " ")


class Face:
    """Three servos of which one is looked at, and what it went through."""

    def __init__(self, state, event):
        given_up = {SUBJECT: "jammed"} if state == "failed" else {}
        self.face = MemoryFace(3, strict=False)
        self.channel, self.tick_s = MemoryTargetChannel(), 0.0
        settings = BridgeSettings(RATE_HZ, tolerant=True, given_up=given_up)
        self.bridge = Bridge(self.face.bus, self.face.joints, self.channel, settings)
        self.servo, self.motors = self.face.chain.servos[SUBJECT], self.face.chain.motors
        self.keeps = state == "failed" and event == "enabled"

    @property
    def state(self):
        return word(self.bridge.servo_states[SUBJECT])

    @property
    def n_restarts(self):
        return sum(data[4:8] == bytes((2, 3, 0, 8)) for _, data in self.face.written)

    def tick(self, seconds=0.0):
        end_s = self.face.clock.now() + seconds
        while True:
            self.tick_s = max(self.tick_s + 1.0 / RATE_HZ, self.face.clock.now())
            self.face.clock.sleep_until(self.tick_s)
            self.channel.publish(ServoTargets(self.tick_s, speech_deg(self.tick_s, 3)))
            self.bridge.tick(self.tick_s)
            if self.face.clock.now() >= end_s:
                return

    def until(self, *states, within_s=30.0):
        end_s = self.face.clock.now() + within_s
        while self.state not in states:
            assert self.face.clock.now() < end_s, f"{self.state}, not {states}"
            self.tick()

    def fall_silent(self, seconds=1000.0):
        self.servo.ignore_until(self.face.clock.now() + seconds)

    def hear(self):
        self.servo.ignore_until(0.0)

    def order(self, switch):
        return self.bridge.obey(ServoOrder(NAME, switch), self.tick_s)

    def warm(self, below_limit_degc):
        self.motors.temperature[SUBJECT] = self.servo["temperature_limit"] - below_limit_degc

    def jam(self):
        self.motors.jammed[SUBJECT] = True
        self.motors.position[SUBJECT] += 250.0  # inside its range, where it may be tried again

    def bring(self, state, event):
        """Into a state, as it is come to."""
        if self.keeps:  # of a frozen face, whose servo has torque nevertheless
            self.servo.write(bytes((64, 0, 1)))
            return
        self.bridge.start()
        self.tick(3.5)
        if state == "waiting":
            self.fall_silent()
            self.until("waiting")
        elif state in ("cooling", "rebooting"):
            if event == "cooled down":
                self.warm(0.0)
            else:
                self.servo.latch(SHOCK_ERROR)
            self.until("cooling")
        elif state == "switching off":
            self.fall_silent()
            self.order(ServoSwitch.OFF)
            self.tick()
        elif state == "off":
            self.order(ServoSwitch.OFF)
            self.tick(0.3)
        if state == "rebooting":
            self.until("rebooting")

    def fail_often(self):
        """As often as a servo may; then in a state for the last time."""
        for _ in range(TRIES):
            self.servo.latch(SHOCK_ERROR)
            self.until("rebooting")
            self.until("driven")
            self.tick(0.5)
        self.servo.latch(SHOCK_ERROR)
        self.until("cooling")


def cause(face, state, event):
    """Let an event come, as it comes."""
    if event in ORDERS:
        face.order(ORDERS[event])
        return
    if event == "silent":
        face.fall_silent()
    elif event == "hardware error":
        face.hear()
        if state == "driven":  # one that does not let go by itself
            face.servo["shutdown"] = 0
        face.servo.latch(SHOCK_ERROR)
    elif event == "too hot":
        face.warm(0.0)
    elif event == "does not follow":
        face.jam()
    elif event == "watchdog tripped":
        face.servo.trip_watchdog()
    elif event == "torque lost":
        face.servo.lose_torque()
    elif event == "still on":
        face.servo["hardware_error_status"] = 0  # with an error it would take no torque
        face.servo.write(bytes((64, 0, 1)))
        assert face.servo.torque_on
        if state == "cooling":
            face.warm(1.0)  # so it stays there for a while
    elif event == "cooled down":
        face.warm(30.0)
    elif event in ("ready", "enabled", "due", "confirmed off"):
        if not face.keeps:
            face.servo.ignore_until(min(face.servo.deaf_until_s, face.face.clock.now() + 0.5))
    elif event == "refused":
        face.servo["homing_offset"] = 500
        face.servo.ignore_until(min(face.servo.deaf_until_s, face.face.clock.now() + 0.5))
    elif event == "all off":
        face.face.chain.unplug()
    if face.keeps:
        face.bridge.start_frozen()


#: How long an event may take, seconds; in the others the servo is looked at for so long.
PATIENCE_S = 3.0
BRIEF_S = 0.7


def test_the_grid_and_the_table_have_the_same_cells():
    by_event = {}
    for (state, event), cell in GRID.items():
        by_event.setdefault((state, event.partition(", ")[0]), []).append(cell)
    empty = (NOTHING, CANNOT_COME)
    merged = {
        key: next((each for each in cells if each not in empty), NOTHING)
        for key, cells in by_event.items()
    }
    assert differences(SERVO_TABLE, merged, ServoState, ServoEvent, word) == []


@pytest.mark.parametrize(("state", "event"), GRID)
def test_in_every_state_an_event_does_what_the_grid_says_and_no_more(state, event):
    cell = GRID[state, event]
    if cell.startswith(CANNOT_COME):
        return
    name, _, often = event.partition(", ")
    then, *does = [state] if cell == NOTHING else cell.split(", ")
    face = Face(state, name)
    with face.face.bus:
        face.bring(state, name)
        if often:
            face.fail_often()
        assert face.keeps or face.state == state
        n_restarts, had_torque = face.n_restarts, face.servo.torque_on
        cause(face, state, name)
        end_s = face.face.clock.now() + (PATIENCE_S if then != state or does else BRIEF_S)
        seen = [face.state]
        while face.face.clock.now() < end_s and (seen[-1] == state or name in ORDERS):
            if name in ORDERS and cell != NOTHING:
                break
            face.tick()
            seen.append(face.state)
        state_then = next((each for each in seen if each != state), state)

        assert state_then == then
        assert then != "failed" or SUBJECT in face.bridge.given_up
        assert face.n_restarts - n_restarts == does.count("again")
        if "off" in does:
            face.tick(0.1)
            assert not face.servo.torque_on
        if "on" in does:
            face.until("driven", within_s=PATIENCE_S)
            assert face.servo.torque_on
        if cell == NOTHING:
            assert face.servo.torque_on == (had_torque and name != "hardware error")
