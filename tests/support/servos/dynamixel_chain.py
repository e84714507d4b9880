"""A face on a simulated chain, for the tests of everything that speaks to servos."""

import numpy as np

from firmware_bridge.clock import ManualClock
from firmware_bridge.dynamixel.bus import DynamixelBus
from firmware_bridge.dynamixel.control_table import servo_models
from firmware_bridge.dynamixel.mounting import MountedServo
from firmware_bridge.joints import Joint
from firmware_bridge.simulator.chain import chain_for
from firmware_bridge.simulator.ports import MemoryTransport

BAUD_RATE = 1_000_000


def mounted(n, model="XL330-M288", **options):
    """`n` servos with ids from 1 on, every other one mounted the other way round."""
    return [
        MountedServo(
            Joint(f"joint_{k}", k, -40.0, 40.0, 300.0, **options),
            servo_models()[model],
            sign=1 if k % 2 else -1,
            zero_offset_deg=float(k % 5),
        )
        for k in range(1, n + 1)
    ]


class MemoryFace:
    """Servos, their chain, a clock and a bus, all in memory; `written` keeps what was sent."""

    def __init__(self, n=3, servos=None, strict=True, watchdog_s=0.1, **chain_options):
        self.clock = ManualClock()
        self.servos = mounted(n) if servos is None else servos
        chain_options.setdefault("baud_rate", BAUD_RATE)
        self.chain = chain_for(self.servos, **chain_options)
        self.written = []
        self.bus = DynamixelBus(self.servos, self.open, strict=strict, watchdog_s=watchdog_s)

    @property
    def joints(self):
        return [servo.joint for servo in self.servos]

    def open(self):
        def tap(time_s, data):
            self.written.append((time_s, data))

        return MemoryTransport(self.chain, self.clock, BAUD_RATE, tap=tap)


def run(face, seconds, goal_deg, rate_hz=100.0):
    """Write the same goal and listen for a while; the feedback of every tick."""
    heard = []
    end_s = face.clock.now() + seconds
    while face.clock.now() < end_s:
        tick_s = face.clock.now() + 1.0 / rate_hz
        face.bus.write_positions(np.asarray(goal_deg, dtype=float))
        heard.append(face.bus.feedback())
        face.bus.look_after()
        face.clock.sleep_until(tick_s)
    return heard


def enable_all(face):
    """Torque on in every servo."""
    for index in range(len(face.servos)):
        assert face.bus.enable_torque(index) == ""
