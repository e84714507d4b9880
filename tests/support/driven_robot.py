"""Servos simulated to the byte, driven by a life cycle in virtual time; what they did is kept."""

import numpy as np
from dynamixel_chain import MemoryFace
from logged import logged

from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.life_cycle import LifeCycle, LifeCycleLinks
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets
from firmware_bridge.process.commands import CommandQueue, command_answer
from firmware_bridge.process.lifeline import Failed, Started, Stopped, Switched
from firmware_bridge.stopping import StopLevel, StopRequest

RATE_HZ = 30.0
#: Instruction write, address 64, value 1.
TORQUE_ON = bytes((3, 64, 0, 1))


class ScriptedControl:
    """A control socket in memory: stops by their moments, in seconds; what it was told last.

    commands: what else is asked of the face, as a socket would.
    """

    def __init__(self, clock, stops):
        self.clock, self.stops, self.end = clock, sorted(stops), None
        self.commands = CommandQueue()
        self.attend, self.take_orders = self.commands.attend, self.commands.take_orders

    def poll(self):
        if self.stops and self.stops[0][0] <= self.clock.now():
            return StopRequest(StopLevel(self.stops.pop(0)[1]), "a test")
        return self.commands.take_stop()

    def answer(self, status, of_stop):
        self.status, self.of_stop = status(), of_stop()

    def report_end(self, report):
        self.end = report


class SupervisorEnd:
    """A supervisor's end of the lifeline."""

    def __init__(self):
        self.n_beats, self.stops, self.failures = 0, [], {}
        self.switches = []

    def beat(self):
        self.n_beats += 1

    def tell(self, message):
        match message:
            case Stopped(level):
                self.stops.append(level)
            case Started():
                self.stops.append(None)
            case Failed(index, reason):
                self.failures[index] = reason
            case Switched(index, on):
                self.switches.append((index, on))


def speech_deg(time_s, n):
    """What speech wants: 15 degrees to and fro, once a second, each joint a little later."""
    return 15.0 * np.sin(2.0 * np.pi * time_s + np.arange(n))


class Robot:
    """Servos simulated to the byte, given targets without end, on a life cycle in virtual time."""

    def __init__(
        self,
        *faults,
        stops=(),
        n=3,
        servos=None,
        tolerant=True,
        waits=False,
        stopped=None,
        **options,
    ):
        self.face = MemoryFace(n, servos=servos, faults=faults, strict=not tolerant)
        self.channel = MemoryTargetChannel()
        settings = BridgeSettings(RATE_HZ, tolerant=tolerant, **options)
        self.bridge = Bridge(self.face.bus, self.face.joints, self.channel, settings)
        self.control, self.told = ScriptedControl(self.face.clock, stops), SupervisorEnd()
        self.log = []
        links = LifeCycleLinks(
            control=self.control,
            lifeline=self.told,
            status=lambda: {"state": self.bridge.state.value},
        )
        self.life = LifeCycle(self.bridge, self.face.clock, links, stopped=stopped, waits=waits)
        self.on_log = lambda _line: None
        #: (time, torque of each servo, position of each) after every tick.
        self.seen = []
        #: (time, goals) of every tick.
        self.sent_deg = []

    def note(self, line):
        self.log.append(line)
        self.on_log(line)

    def say(self, word):
        """A word of the control socket; what is answered."""
        return command_answer(word, self.control.commands, lambda: "a test")

    def state(self, name):
        """Of one servo, as the status tells it."""
        return self.bridge.as_dict()["servos"][name]

    def live(self, until_s, at=None):
        """From start to end; `at`: what happens at a moment, by its time."""
        at = dict(at or {})
        with logged("firmware_bridge", self.note), self.face.bus, self.life as life:
            life.start()
            for time_s, late in life.ticks():
                for moment_s in [m for m in at if m <= time_s]:
                    at.pop(moment_s)()
                if time_s > until_s:
                    break
                self.channel.publish(
                    ServoTargets(time_s, speech_deg(time_s, len(self.face.servos)))
                )
                report = self.bridge.tick(time_s, late)
                torque = [servo.torque_on for servo in self.face.chain.servos]
                self.seen.append((time_s, torque, self.face.chain.motors.position.copy()))
                self.sent_deg.append((time_s, report.sent_deg))
        return life.report

    @property
    def stiff(self):
        return [servo.index for servo in self.face.chain.servos if servo.torque_on]

    def torque_writes(self, since_s):
        """Writes of 1 to torque_enable after `since_s`, on the wire."""
        return [s for s, data in self.face.written if s > since_s and data[7:11] == TORQUE_ON]
