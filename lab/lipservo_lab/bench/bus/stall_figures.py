"""A face on two buses of which one stands still: what its other bus notices, and what two cost."""

import threading
import time

import numpy as np

from firmware_bridge.bus import Array, Feedback, ServoBus
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
#: Of the ticks that are watched, the stall is the middle third.
_WATCHED_S = 3.0 * _STALL_S
_CPU_TICKS = 400


class _StallingBus(SimulatedBus):
    """Its wire stands still from `stalls_s` on, for two seconds, in the middle of a question."""

    stalls_s = float("inf")

    def feedback(self) -> Feedback:
        """What is known of the servos, once the wire has gone on."""
        if time.monotonic() >= self.stalls_s:
            self.stalls_s = float("inf")
            time.sleep(_STALL_S)
        return super().feedback()


class _CountingBus(SimulatedBus):
    """Counts the goals that reach it between two times."""

    n_goals = 0
    counts = threading.Event()

    def write_positions(self, positions_deg: Array) -> None:
        """Count the goals, and pass them on."""
        self.n_goals += self.counts.is_set()
        super().write_positions(positions_deg)


def _joints(n: int = _N_SERVOS) -> list[Joint]:
    return [Joint(f"joint_{k}", k, -40.0, 40.0, 300.0) for k in range(n)]


def stall_figures() -> dict[str, float]:
    """One bus stalls for two seconds at 100 Hz: ticks that came late, before and meanwhile.

    goals_in_stall_share: of the goals that were due on the other bus while the first stood still.
    """
    clock, joints = MonotonicClock(), _joints()
    halves = (joints[: _N_SERVOS // 2], joints[_N_SERVOS // 2 :])
    stalling = _StallingBus(halves[0], clock, capabilities=IN_MEMORY)
    other = _CountingBus(halves[1], clock, capabilities=IN_MEMORY)
    bus_of = ["first"] * len(halves[0]) + ["second"] * len(halves[1])
    bus = SeveralBuses({"first": stalling, "second": other}, bus_of, clock, _RATE_HZ)
    n_late = {"before": 0, "in": 0}
    with bus, on_time():
        channel = MemoryTargetChannel()
        bridge = Bridge(bus, joints, channel, BridgeSettings(_RATE_HZ))
        bridge.start()
        begins_s = clock.now() + _WATCHED_S / 3.0
        stalling.stalls_s, ends_s = begins_s, begins_s + _STALL_S
        for time_s, late in ticks(clock, _RATE_HZ):
            if time_s >= ends_s:
                break
            is_stalled = time_s >= begins_s
            n_late["in" if is_stalled else "before"] += late
            if is_stalled:
                other.counts.set()
            channel.publish(ServoTargets(time_s, np.full(_N_SERVOS, 5.0 * np.sin(time_s))))
            bridge.tick(time_s, late)
        n_goals = other.n_goals
        other.counts.clear()
    return {
        "late_ticks_in_stall": float(n_late["in"]),
        "late_ticks_before_stall": float(n_late["before"]),
        "goals_in_stall_share": n_goals / (_STALL_S * _RATE_HZ),
        "cpu_of_two_buses_us": _tick_us(two=True) - _tick_us(two=False),
    }


def _tick_us(*, two: bool) -> float:
    """CPU of a tick of sixteen servos in memory, on one bus or on two; no wire."""
    clock, joints, n = MonotonicClock(), _joints(), _N_SERVOS // 2
    one: ServoBus = SimulatedBus(joints, clock)
    if two:
        buses = {"a": SimulatedBus(joints[:n], clock), "b": SimulatedBus(joints[n:], clock)}
        one = SeveralBuses(buses, ["a"] * n + ["b"] * n, clock, _RATE_HZ)
    with one as bus:
        channel = MemoryTargetChannel()
        bridge = Bridge(bus, joints, channel, BridgeSettings(_RATE_HZ))
        bridge.start()
        began_s = time.process_time()
        for number, (time_s, late) in enumerate(ticks(clock, _RATE_HZ)):
            if number == _CPU_TICKS:
                break
            channel.publish(ServoTargets(time_s, np.full(_N_SERVOS, 5.0 * np.sin(time_s))))
            bridge.tick(time_s, late)
        return (time.process_time() - began_s) / _CPU_TICKS * 1e6
