"""Processor time of a whole tick of the bridge, beside the same servo traffic by others."""

import statistics
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, Protocol

import numpy as np

from firmware_bridge.clock import ManualClock
from firmware_bridge.dynamixel.bus import DynamixelBus
from firmware_bridge.dynamixel.control_table import servo_models
from firmware_bridge.dynamixel.mounting import MountedServo
from firmware_bridge.joints import Joint
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets
from firmware_bridge.serial_servos.serial_transport import open_port
from firmware_bridge.transport import Transport
from lipservo_lab.bench.bus.servo_clients import (
    BAUD_RATE,
    AnswerLost,
    SdkClient,
    ServoClient,
    canned_peer,
)

N_SERVOS: Final = 20
_MODEL: Final = servo_models()["XL330-M288"]
_IDS: Final = list(range(1, N_SERVOS + 1))
_RATE_HZ: Final = 100.0
#: Until every servo has its full strength, which takes a second; the others get as many calls.
_SETTLES_S: Final = 0.1
_WARM_UP_BLOCKS, _BLOCKS, _CALLS = 15, 80, 10


class Client(Protocol):
    """Sends goals to servos and reads their state, one call at a time."""

    def prepare(self, n: int) -> None:
        """Prepare the data of call n; not timed."""

    def work(self) -> object:
        """Run one round; timed."""


def tick_ratios() -> dict[str, float]:
    """Return CPU time of `Bridge.tick`, us, and over that of dynamixel-sdk: least and median calls.

    Ours: targets, limits, goals written, positions read, one servo's health read, supervision,
    tracking. dynamixel-sdk: goals written, positions read (fast sync read), voltage and temperature
    of all read (sync read), each value fetched as its examples do; no limits, no hardware errors.

    Thread CPU time of every call, in interleaved blocks of ten, at peers that answer at once: wire
    time, during which dynamixel-sdk polls and we sleep, is left out. It polls while it waits for a
    peer, too: the least calls have the least of that, the median ones the usual. Its LATENCY_TIMER
    only says when it gives up, so it is unchanged. Calls whose answer was lost do not count.
    """
    with own_tick() as own, canned_peer(N_SERVOS) as port:
        clients: dict[str, Client] = {"own": own, "sdk": OthersTick(SdkClient(port, N_SERVOS))}
        spent_us = _calls_us(clients)
    least_us = {name: min(each) for name, each in spent_us.items()}
    median_us = {name: statistics.median(each) for name, each in spent_us.items()}
    return {
        "cpu_tick_us": least_us["own"],
        "cpu_tick_median_us": median_us["own"],
        "cpu_tick_ratio": least_us["own"] / least_us["sdk"],
        "cpu_tick_ratio_median": median_us["own"] / median_us["sdk"],
    }


def _calls_us(clients: dict[str, Client]) -> dict[str, list[float]]:
    """Return the processor time of every answered call, in microseconds, by client."""
    spent_us: dict[str, list[float]] = {name: [] for name in clients}
    n = 0
    for block in range(_WARM_UP_BLOCKS + _BLOCKS):
        for name, client in clients.items():
            for call_number in range(n, n + _CALLS):
                client.prepare(call_number)
                begun_ns = time.thread_time_ns()
                try:
                    client.work()
                except AnswerLost:
                    time.sleep(_SETTLES_S)  # or the next question would get the late answer
                    continue
                spent_ns = time.thread_time_ns() - begun_ns
                if block >= _WARM_UP_BLOCKS:
                    spent_us[name].append(spent_ns * 1e-3)
        n += _CALLS
    return spent_us


def moving_deg(time_s: float, n_servos: int = N_SERVOS) -> np.ndarray:
    """Return the joints' targets at a time: 4 degrees to and fro at 2 Hz, (n_servos,)."""
    return np.asarray(4.0 * np.sin(2.0 * np.pi * 2.0 * time_s + 0.3 * np.arange(n_servos)))


@contextmanager
def own_tick() -> Iterator["OwnTick"]:
    """Yield a started bridge of 20 servos, for which a canned peer answers at once."""
    with canned_peer(N_SERVOS) as port:
        tick = OwnTick(port)
        with tick.bus:
            tick.bridge.start()
            yield tick


class _SlowPort:
    """A port that waits a second longer for answers, since a busy computer may delay them."""

    baud_rate = BAUD_RATE

    def __init__(self, transport: Transport) -> None:
        self.clock = transport.clock
        self.write = transport.write
        self.discard_input = transport.discard_input
        self.close = transport.close
        self._read = transport.read

    def read(self, deadline_s: float) -> bytes:
        """Return what arrives until a second after `deadline_s`."""
        return self._read(deadline_s + 1.0)


class OwnTick:
    """A bridge as `run` makes it, on a clock that moves 10 ms a tick and never waits."""

    def __init__(self, port: str) -> None:
        joints = [Joint(f"joint_{n}", n, -40.0, 40.0, 300.0) for n in _IDS]
        servos = [MountedServo(joint, _MODEL, 1 if n % 2 else -1) for n, joint in enumerate(joints)]
        self._clock = ManualClock()
        self._channel = MemoryTargetChannel()
        self._time_s = 0.0
        self.bus = DynamixelBus(servos, lambda: _SlowPort(open_port(port, BAUD_RATE, self._clock)))
        self.bridge = Bridge(self.bus, joints, self._channel, BridgeSettings(_RATE_HZ))

    def prepare(self, n: int) -> None:
        """Wait for the next grid time and publish a target half a tick later."""
        self._time_s = max(self._time_s + 1.0 / _RATE_HZ, self._clock.now())
        self._clock.sleep_until(self._time_s)
        self._channel.publish(ServoTargets(self._time_s + 0.5 / _RATE_HZ, moving_deg(n / _RATE_HZ)))

    def work(self) -> object:
        """Run one tick of the bridge."""
        return self.bridge.tick(self._time_s)


class OthersTick:
    """The same motion, given to another client as position registers."""

    def __init__(self, client: ServoClient) -> None:
        self._client = client
        self._goals: list[int] = []

    def prepare(self, n: int) -> None:
        """Prepare twenty registers."""
        pulses = _MODEL.center_pulse + moving_deg(n / _RATE_HZ) * _MODEL.pulses_per_deg
        self._goals = pulses.astype(np.int64).tolist()

    def work(self) -> object:
        """Run one round of the other client."""
        return self._client.work(self._goals)
