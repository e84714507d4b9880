"""A face on two buses of which one stands still: what its other bus notices of it."""

import time

import numpy as np

from firmware_bridge.bus import Feedback
from firmware_bridge.capabilities import IN_MEMORY
from firmware_bridge.clock import MonotonicClock, ticks
from firmware_bridge.joints import Joint
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets
from firmware_bridge.process.operating_system import on_time
from firmware_bridge.several_buses import SeveralBuses
from firmware_bridge.simulator.bus import SimulatedBus

_RATE_HZ = 100.0
_STALL_S = 2.0
_N_SERVOS = 16
#: Before the stall.
_QUIET_S = 2.0


class _StallingBus(SimulatedBus):
    """A simulated bus whose wire stalls once, for two seconds, while feedback is read."""

    stalls_s = float("inf")

    def stall_at(self, time_s: float) -> None:
        """Let the first reading of feedback from `time_s` (monotonic) on stall."""
        self.stalls_s = time_s

    def feedback(self) -> Feedback:
        """Return the feedback, once the stalled wire goes on."""
        if time.monotonic() >= self.stalls_s:
            self.stalls_s = float("inf")
            time.sleep(_STALL_S)
        return super().feedback()


def _joints(n: int = _N_SERVOS) -> list[Joint]:
    return [Joint(f"joint_{k}", k, -40.0, 40.0, 300.0) for k in range(n)]


def stall_figures() -> dict[str, float]:
    """Return how many ticks of a 100 Hz bridge come late while one of its two buses stalls for 2 s.

    Both buses are simulated; the bridge drives them through `SeveralBuses`.
    """
    clock, joints = MonotonicClock(), _joints()
    halves = (joints[: _N_SERVOS // 2], joints[_N_SERVOS // 2 :])
    stalling_bus = _StallingBus(halves[0], clock, capabilities=IN_MEMORY)
    other_bus = SimulatedBus(halves[1], clock, capabilities=IN_MEMORY)
    bus_of = ["first"] * len(halves[0]) + ["second"] * len(halves[1])
    bus = SeveralBuses({"first": stalling_bus, "second": other_bus}, bus_of, clock, _RATE_HZ)
    n_late = 0
    with bus, on_time():
        channel = MemoryTargetChannel()
        bridge = Bridge(bus, joints, channel, BridgeSettings(_RATE_HZ))
        bridge.start()
        stall_begins_s = clock.now() + _QUIET_S
        stalling_bus.stall_at(stall_begins_s)
        for time_s, late in ticks(clock, _RATE_HZ):
            if time_s >= stall_begins_s + _STALL_S:
                break
            n_late += late if time_s >= stall_begins_s else 0
            channel.publish(ServoTargets(time_s, np.full(_N_SERVOS, 5.0 * np.sin(time_s))))
            bridge.tick(time_s, late)
    return {"late_ticks_in_stall": float(n_late)}
