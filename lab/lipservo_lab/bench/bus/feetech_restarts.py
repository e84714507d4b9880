"""Feetech servos that restart while they move: how fast a shaft goes within a second of it.

A goal switches torque on in a limp servo, and a restart forgets every bound, so that the next goal
after a short one would be run to at full speed. The real bus drives simulated servos on a virtual
clock.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Final

import numpy as np

from firmware_bridge.clock import ManualClock, ticks
from firmware_bridge.feetech.bus import FeetechBus
from firmware_bridge.feetech.control_table import servo_models
from firmware_bridge.feetech.simulator import SimulatedChain, chain_for
from firmware_bridge.joints import Joint
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets
from firmware_bridge.serial_servos.mounting import MountedServo
from firmware_bridge.simulator.motors import PULSES_PER_DEG
from firmware_bridge.simulator.ports import MemoryTransport

#: A servo whose torque has just come on may go no faster.
SOFT_START_DEG_S: Final = 60.0
#: A shaft may be so much faster than the bound.
MOST_OVER: Final = 1.1
#: How long a restart may take; a servo that takes longer is noticed as silent.
RESTARTS_S: Final = (0.01, 0.02, 0.04, 0.06, 0.08, 0.095, 0.105, 0.15, 0.2, 0.3, 0.5)
_MODELS: Final = ("STS3215", "SCS0009")
#: At so many moments of the motion to and fro.
_N_TIMES: Final = 3
_N_SERVOS: Final = 4
_BAUD_RATE: Final = 1_000_000
_RATE_HZ: Final = 50.0
_FROM_S: Final = 4.0
_WATCH_S: Final = 1.0
_AMPLITUDE_DEG, _MOTION_HZ = 20.0, 1.5
_STEP_S: Final = 0.005


@dataclass(frozen=True, slots=True)
class Restart:
    """One servo's power fails for a moment. stiff: it comes back with torque on."""

    model: str
    at_s: float
    lasts_s: float
    stiff: bool


def restarts() -> Iterator[Restart]:
    """Yield all restarts that are tried."""
    times_s = _FROM_S + np.arange(_N_TIMES) / _N_TIMES / _MOTION_HZ
    for model, at_s, lasts_s, stiff in product(
        _MODELS, times_s.tolist(), RESTARTS_S, (False, True)
    ):
        yield Restart(model, at_s, lasts_s, stiff)


def over_bound(case: Restart) -> float:
    """Return the top speed within a second of a restart, over the soft start's bound."""
    return fastest_deg_s(case) / SOFT_START_DEG_S


def fastest_deg_s(case: Restart) -> float:
    """Return the top speed of the restarted servo's shaft within a second of its restart, deg/s.

    Simulated servos follow sines on a virtual clock; the first of them restarts.
    """
    joints = [Joint(f"joint_{n}", n, -40.0, 40.0, 260.0) for n in range(1, _N_SERVOS + 1)]
    model = servo_models()[case.model]
    servos = [MountedServo(joint, model, 1) for joint in joints]
    clock, channel = ManualClock(), MemoryTargetChannel()
    chain = chain_for(servos, _BAUD_RATE, wakes_up_stiff=case.stiff)
    shaft = _WatchedShaft(chain, 1)
    bus = FeetechBus(
        servos,
        lambda: MemoryTransport(shaft, clock, _BAUD_RATE),
        strict=False,
        period_s=1.0 / _RATE_HZ,
    )
    has_restarted = False
    with bus:
        bridge = Bridge(bus, joints, channel, BridgeSettings(_RATE_HZ, tolerant=True))
        bridge.start()
        for time_s, late in ticks(clock, _RATE_HZ):
            if time_s > case.at_s + _WATCH_S:
                break
            if not has_restarted and time_s >= case.at_s:
                has_restarted = True
                _power_cycle(chain, 1, clock.now(), case.lasts_s)
                shaft.begin()
            angle = 2.0 * np.pi * _MOTION_HZ * time_s
            goals_deg = _AMPLITUDE_DEG * np.sin(angle + np.arange(_N_SERVOS))
            channel.publish(ServoTargets(time_s + 0.01, goals_deg))
            bridge.tick(time_s, late)
        fastest_pulses_s = shaft.fastest
    return fastest_pulses_s / PULSES_PER_DEG


class _WatchedShaft:
    """A simulated chain that is advanced in small steps, to find one shaft's top speed.

    index: the servo. fastest: its top speed since `begin`, pulses a second.
    """

    def __init__(self, chain: SimulatedChain, index: int) -> None:
        self._chain, self._index = chain, index
        self._now_s = self.fastest = 0.0

    def begin(self) -> None:
        self.fastest = 0.0

    @property
    def plugged(self) -> bool:
        return self._chain.plugged

    @property
    def next_delivery_s(self) -> float:
        return self._chain.next_delivery_s

    def advance(self, now_s: float) -> None:
        while self._now_s < now_s:
            self._now_s = min(self._now_s + _STEP_S, now_s)
            self._chain.advance(self._now_s)
            self.fastest = max(self.fastest, abs(float(self._chain.motors.velocity[self._index])))

    def receive(self, data: bytes, now_s: float, baud_rate: int) -> None:
        self.advance(now_s)
        self._chain.receive(data, now_s, baud_rate)

    def deliver(self, now_s: float) -> bytes:
        return self._chain.deliver(now_s)


def _power_cycle(chain: SimulatedChain, index: int, now_s: float, lasts_s: float) -> None:
    """Let a servo restart now: limp, at a standstill, and silent for `lasts_s`."""
    chain.advance(now_s)
    servo = chain.servos[index]
    servo.power_up()
    servo.silent_until_s = now_s + lasts_s
    chain.motors.velocity[index] = 0.0  # of before; limp, it stands
