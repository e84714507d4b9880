"""Goals for simulated servos, through the bridge and its safety gate: no speech.

Start:  python examples/simulated_servos.py

A jaw opens and closes once a second, and for the last half second is asked for 90 degrees, which
it must not reach. Printed is a line every 0.1 s: what was wanted, and what the gate let through to
the servo; at the end, which servos confirmed that their torque is off. Real servos take the same
calls: `bus_for` in `lipservo/runtime/servos/assembly.py` makes a bus at a port.
"""

import math

import numpy as np

from firmware_bridge.clock import ManualClock
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.life_cycle import LifeCycle
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets
from firmware_bridge.simulator.bus import SimulatedBus
from lipservo.settings.settings import load_shipped_face

RATE_HZ = 50.0
LENGTH_S = 2.0


def wanted_deg(time_s: float) -> float:
    """The angle that the jaw is asked for."""
    if time_s > LENGTH_S - 0.5:
        return 90.0
    return 10.0 - 10.0 * math.cos(2.0 * math.pi * time_s)


def main() -> None:
    """Publish one target a tick; the bridge makes of it a goal that the joint can take."""
    joints = load_shipped_face("face_jaw").joints()
    clock, channel = ManualClock(), MemoryTargetChannel()
    with SimulatedBus(joints, clock) as bus:
        bridge = Bridge(bus, joints, channel, BridgeSettings(RATE_HZ))
        with LifeCycle(bridge, clock) as life:
            life.start()
            for time_s, late in life.ticks():
                if time_s >= LENGTH_S:
                    break
                angle_deg = wanted_deg(time_s)
                channel.publish(ServoTargets(time_s, np.array([angle_deg])))
                report = bridge.tick(time_s, late)
                if round(time_s * RATE_HZ) % 5 == 0:
                    sent_deg = report.sent_deg[0]
                    print(f"{time_s:4.2f} s  wanted {angle_deg:5.1f} deg  sent {sent_deg:5.1f} deg")
    assert life.report is not None
    print(life.report.text())


if __name__ == "__main__":
    main()
