"""Every state in the course of a face x every event: the state then, torque, and what is answered.

The grid is the machine, told a second time by hand. In a cell: the new state, and what becomes of
torque: driven, holds (who had torque keeps it, nobody gets any), limp (every servo at the end);
told: whoever asked is told the end. A dot: the event means nothing; x: nothing can cause it, or no
moment in between (a start that ends a freeze is through at once), and what stands behind it is in
the table for safety. Behind an event stands what it found: a process that waits for a start, or a
face that is being let go.
"""

import contextlib
import os
import signal

import pytest
from driven_robot import Robot, speech_deg
from dynamixel_chain import mounted
from state_grid import CANNOT_COME, NOTHING, differences, grid

from firmware_bridge.errors import PortError, ServoError
from firmware_bridge.loop.face_table import FaceState
from firmware_bridge.loop.life_cycle import ImmediateStop
from firmware_bridge.loop.life_table import LIFE_TABLE, LifeEvent, LifeState
from firmware_bridge.loop.targets import ServoTargets
from firmware_bridge.stopping import StopLevel, StopRequest

GRID = grid("""
                    | not started      | starting         | running         | frozen                   | stopping            | waiting          | ending          | leaving         | frozen at the end | disabling | over
start               | starting, driven | .                | .               | running, driven          | .                   | starting, driven | .               | .               | .                 | x         | .
started             | x                | running, driven  | x               | .                        | .                   | x                | .               | .               | x                 | x         | x
start failed        | x                | ending, limp     | x               | x                        | x                   | x                | x               | x               | x                 | x         | x
start failed, waits | x                | stopping, limp   | x               | x                        | x                   | x                | x               | x               | x                 | x         | x
start frozen        | frozen, holds    | x                | x               | x                        | x                   | x                | x               | x               | x                 | x         | x
freeze              | .                | frozen, holds    | frozen, holds   | frozen, holds            | frozen, holds       | .                | ending, holds   | leaving, holds  | .                 | x         | .
freeze, letting go  | x                | x                | x               | x                        | .                   | x                | .               | .               | x                 | x         | x
stop                | ending, limp     | ending, limp     | ending, limp    | ending, limp             | x                   | x                | ending, limp    | leaving, limp   | leaving, limp     | x         | .
stop, waits         | stopping, limp   | stopping, limp   | stopping, limp  | stopping, limp           | stopping, limp      | stopping, limp   | ending, limp    | leaving, limp   | leaving, limp     | x         | x
stop and end        | ending, limp     | ending, limp     | ending, limp    | ending, limp             | ending, limp        | ending, limp     | ending, limp    | leaving, limp   | leaving, limp     | x         | .
signal              | leaving, limp    | leaving, limp    | leaving, limp   | leaving, limp            | leaving, limp       | leaving, limp    | leaving, limp   | leaving, limp   | leaving, limp     | x         | x
program's end       | .                | leaving, limp    | leaving, limp   | frozen at the end, holds | leaving, limp       | .                | leaving, limp   | .               | .                 | x         | .
limp                | x                | x over           | over, limp      | over, limp               | waiting, limp, told | x                | over, limp      | over, limp      | x over            | x         | x
port is lost        | .                | x                | .               | .                        | .                   | .                | .               | over            | .                 | x         | x
disable             | disabling, limp  | disabling, limp  | disabling, limp | disabling, limp          | disabling, limp     | disabling, limp  | disabling, limp | disabling, limp | disabling, limp   | x         | x disabling
left                | x over           | x over           | x over          | x over                   | x over              | x over           | x over          | x over          | x over            | over      | x
""")  # noqa: E501 - a table
STOPS = {
    "freeze": (StopLevel.FREEZE, False),
    "stop": (StopLevel.SOFT, False),
    "stop and end": (StopLevel.LIMP, True),
}
#: Events of which it is known in the next round what they did.
AT_ONCE = ("start", "start frozen", "freeze", "stop", "stop and end", "signal", "program's end")
#: How a start is stopped, by the state that follows.
STOPPED_IN_A_START = {
    "frozen": "freeze",
    "stopping": "stop, waits",
    "ending": "stop",
    "leaving": "signal",
}
#: Servos are looked at so long after an event, when every way to rest is over.
LATER_S = 4.5


def press(n_signals=1):
    for _ in range(n_signals):
        os.kill(os.getpid(), signal.SIGTERM)


class Course:
    """The course of a face in which an event comes in a state: what became of it."""

    def __init__(self, state, event, found):
        self.state, self.event, self.found = LifeState(state), event, found
        self.waits = found == "waits" or state in ("stopping", "waiting")
        stopped = None
        if event == "start frozen" and state == "not started":
            stopped = StopRequest(StopLevel.FREEZE, "a test")
        critical = event == "start failed" or (event == "limp" and state in ("running", "frozen"))
        servos = mounted(3, critical=True) if critical else None
        self.robot = Robot(tolerant=False, waits=self.waits, servos=servos, stopped=stopped)
        self.life, self.bridge = self.robot.life, self.robot.bridge
        self.poll, self.robot.control.poll = self.robot.control.poll, self.look
        self.steps = list(self.way())
        self.came_s, self.after, self.ended = None, None, False
        self.stiff_then = self.stiff_later = None

    def way(self):
        """What leads to the state: (when, what)."""
        commands = self.robot.control.commands
        if self.event == "start failed":
            level = StopLevel.LIMP if self.waits else StopLevel.FREEZE
            yield 1.0, lambda: commands.stop(level, "a test")
            yield 1.5, self.fail_to_start
        if self.event == "limp" and self.state in (LifeState.RUNNING, LifeState.FROZEN):
            yield 1.0, self.jam
            return
        if self.state in (LifeState.NOT_STARTED, LifeState.STARTING, LifeState.RUNNING):
            return
        if self.found == "letting go":
            yield 0.9, lambda: self.robot.face.chain.servos[2].ignore_until(3.5)
        if self.state is LifeState.LEAVING:
            yield 1.0, self.life.stop if self.event == "signal" else press  # it would be a second
        elif self.state in (LifeState.FROZEN, LifeState.FROZEN_LAST):
            yield 1.0, lambda: commands.stop(StopLevel.FREEZE, "a test")
        elif self.state in (LifeState.STOPPING, LifeState.ENDING):
            ends = self.state is LifeState.ENDING
            yield 1.0, lambda: commands.stop(StopLevel.SOFT, "a test", ends=ends)
        elif self.state is LifeState.WAITING:
            yield 1.0, lambda: commands.stop(StopLevel.LIMP, "a test")
        if self.found == "letting go":
            yield 1.05, lambda: commands.stop(StopLevel.LIMP, "a test")

    def fail_to_start(self):
        """A servo is silent; or, of a frozen face, of which none is asked, the port fails."""

        def fail():
            raise PortError("a test")

        if self.waits:
            self.robot.face.chain.servos[1].ignore_until(float("inf"))
        else:
            self.robot.face.bus.read = fail
        self.robot.say("start")
        self.came_s, self.stiff_then = self.now_s, self.robot.stiff

    def jam(self):
        """A critical servo, for good; frozen, once the face is being let go for it."""
        self.robot.face.chain.motors.jammed[1] = True
        self.robot.face.chain.motors.position[1] += 400.0

    @property
    def now_s(self):
        return self.robot.face.clock.now()

    def look(self):
        """In the place of the control socket, in every round: what is due, then its own answer."""
        life = self.life
        if self.came_s is None:
            while self.steps and self.steps[0][0] <= self.now_s:
                self.steps.pop(0)[1]()
            if not self.steps and self.is_there():
                self.happen()
        elif self.after is None and (life.state is not self.state or self.event in AT_ONCE):
            self.note()
        if self.came_s is not None and not self.ended and self.now_s >= self.came_s + self.lasts_s:
            self.finish()
        return self.poll()

    def is_there(self):
        if self.life.state is not self.state:
            return False
        if self.state is LifeState.STARTING:
            return bool(self.robot.stiff)
        if self.state is LifeState.RUNNING:
            return self.now_s > 1.0
        if self.state is LifeState.FROZEN:
            return self.now_s > 1.2
        if self.found == "letting go":
            return self.bridge.state is FaceState.LETTING_GO
        return True

    def happen(self):
        self.came_s, self.stiff_then = self.now_s, self.robot.stiff
        if self.event in STOPS:
            level, ends = STOPS[self.event]
            self.robot.control.commands.stop(level, "a test", ends=ends)
        elif self.event == "start":
            self.robot.say("start")
        elif self.event == "signal":
            press()
        elif self.event == "program's end":
            self.life.stop()
        elif self.event == "disable":
            with contextlib.suppress(ImmediateStop):
                press(2)
            self.after = self.life.state
            raise ImmediateStop
        elif self.event == "port is lost":
            self.robot.face.chain.unplug()

    @property
    def lasts_s(self):
        if self.event == "limp" and self.state in (LifeState.RUNNING, LifeState.FROZEN):
            return 60.0
        return 40.0 if self.event == "port is lost" else LATER_S

    def note(self):
        self.after, self.said = self.life.state, getattr(self.robot.control, "of_stop", None)
        self.stiff_now = self.robot.stiff
        servos = self.robot.face.chain.servos
        self.deaf = [each.index for each in servos if each.deaf_until_s > self.now_s]

    def finish(self):
        self.ended, self.stiff_later = True, self.robot.stiff
        if self.after is None:
            self.note()
        self.robot.face.chain.plug_in()
        self.robot.control.commands.stop(StopLevel.LIMP, "the test is over", ends=True)

    def live(self):
        try:
            self.go_through()
        finally:
            self.after = self.after or self.life.state
            if self.stiff_later is None:
                self.stiff_later = self.robot.stiff

    def go_through(self):
        robot, life = self.robot, self.life
        if self.state is LifeState.NOT_STARTED and self.event == "start frozen":
            for servo in robot.face.chain.servos[:2]:
                servo.write(bytes((64, 0, 1)))
        with robot.face.bus, life:
            if self.state is not LifeState.NOT_STARTED:
                life.start()
                if self.event == "started":
                    self.came_s, self.stiff_then = self.now_s, robot.stiff
                if self.came_s is not None and self.after is None:
                    self.note()
            elif self.event in ("start", "start frozen"):
                self.came_s, self.stiff_then = 0.0, robot.stiff
                life.start()
            for time_s, late in life.ticks():
                robot.channel.publish(ServoTargets(time_s, speech_deg(time_s, 3)))
                self.bridge.tick(time_s, late)
                if self.state is LifeState.FROZEN_LAST and time_s > 1.2:
                    break
                self.freeze_too_late()
            if self.after is None and self.came_s is not None:
                self.after = life.state

    def freeze_too_late(self):
        """A face that is let go since a critical servo failed."""
        is_let_go = self.event == "limp" and self.bridge.state is FaceState.LETTING_GO
        is_live = self.state is LifeState.FROZEN and self.life.state is LifeState.RUNNING
        if is_let_go and is_live:
            self.robot.control.commands.stop(StopLevel.FREEZE, "a test")


def test_the_grid_and_the_table_have_the_same_cells():
    by_event = {}
    for (state, event), cell in GRID.items():
        by_event.setdefault((state, event.partition(", ")[0]), []).append(cell)
    empty = (NOTHING, CANNOT_COME)
    merged = {
        key: next((each for each in cells if each not in empty), NOTHING)
        for key, cells in by_event.items()
    }
    assert differences(LIFE_TABLE, merged, LifeState, LifeEvent) == []


@pytest.mark.parametrize(("state", "event"), GRID)
def test_in_every_state_an_event_does_what_the_grid_says_and_no_more(state, event):
    cell = GRID[state, event]
    if cell.startswith(CANNOT_COME):
        return
    name, _, found = event.partition(", ")
    if state == "over":
        nothing_follows_the_end(name)
        return
    if name == "left":
        state, name = "running", "disable"
    elif name == "started" and state != "starting":  # a start that was stopped goes on to its end
        name, _, found = STOPPED_IN_A_START[state].partition(", ")
        cell, state = f"{state}, {'holds' if state == 'frozen' else 'limp'}", "starting"
    course = Course(state, name, found)
    is_failure = name == "limp" and state in ("running", "frozen")
    with pytest.raises(ServoError, match="critical") if is_failure else contextlib.nullcontext():
        course.live()
    then, *does = [state] if cell == NOTHING else cell.split(", ")

    assert course.life.state is LifeState.OVER
    if event == "left":
        return
    assert course.after == then
    if name in STOPS and course.after is not LifeState.OVER:
        said = [
            key for name in course.bridge.names for key in course.said if name in course.said[key]
        ]
        truth = ["holds" if i in course.stiff_now else "limp" for i in range(3)]
        if (state, name) == ("not started", "freeze"):  # no servo has been read yet
            truth = ["unknown"] * 3
        assert said == [truth[i] if i not in course.deaf else "unknown" for i in range(3)]
    if name in STOPS and (course.after is not LifeState.RUNNING):
        assert course.robot.torque_writes(course.came_s) == []
    if "holds" in does:
        assert course.stiff_later == course.stiff_then
        assert course.stiff_then
    if "limp" in does:
        assert course.stiff_later == []
    if "driven" in does:
        assert course.stiff_later == [0, 1, 2]
    if "told" in does:
        assert course.robot.control.end is not None


def nothing_follows_the_end(event):
    robot = Robot(stops=[(1.0, "limp")])
    robot.live(5.0)
    end_s = robot.face.clock.now()
    with robot.face.bus:
        if event == "start":
            robot.life.start()
        elif event == "program's end":
            robot.life.stop()
        else:
            level, ends = STOPS[event]
            robot.control.commands.stop(level, "a test", ends=ends)
        assert list(robot.life.ticks()) == []
        assert robot.life.state is LifeState.OVER
        assert robot.stiff == robot.torque_writes(end_s) == []
