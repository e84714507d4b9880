"""Processor time of a whole tick of the bridge, beside the same servo traffic by others."""

import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec
from typing import Final, Protocol

import numpy as np

from firmware_bridge.clock import ManualClock
from firmware_bridge.dynamixel.bus import DynamixelBus
from firmware_bridge.dynamixel.control_table import servo_models
from firmware_bridge.dynamixel.mounting import MountedServo
from firmware_bridge.dynamixel.wire.serial_transport import open_port
from firmware_bridge.dynamixel.wire.transport import Transport
from firmware_bridge.joints import Joint
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.channel import MemoryTargetChannel
from firmware_bridge.loop.settings import BridgeSettings
from firmware_bridge.targets import ServoTargets

N_SERVOS: Final = 20
_IDS: Final = list(range(1, N_SERVOS + 1))
#: goal_position; present_current, present_velocity, present_position; voltage, temperature.
_GOAL, _MOTION, _MOTION_SIZE, _WARMTH, _WARMTH_SIZE = 116, 126, 10, 144, 3
_MOTION_TYPE = np.dtype([("current", "<i2"), ("velocity", "<i4"), ("position", "<i4")])
_WARMTH_TYPE = np.dtype([("voltage", "<u2"), ("temperature", "u1")])
_BAUD_RATE: Final = 4_000_000
#: What the ratios over each of them are called: cpu_tick*_ratio.
_KEYS: Final = {"sdk": "", "sdk_all_fast": "_all_fast", "rustypot": "_rustypot"}
_RATE_HZ: Final = 100.0
#: Until every servo has its full strength, which takes a second; the others get as many calls.
_SETTLES_S: Final = 0.1
_WARM_UP_BLOCKS, _BLOCKS, _CALLS = 15, 80, 10


class AnswerLost(Exception):  # noqa: N818 - no mistake of anybody: the computer was busy
    """The peer was too late, or the end of its answer: the call does not count."""


class Client(Protocol):
    """Somebody who moves and watches the servos."""

    def prepare(self, n: int) -> None:
        """What is new for call n; not timed."""

    def work(self) -> object:
        """One round; timed."""


def tick_ratios() -> dict[str, float]:
    """CPU of `Bridge.tick` over that of dynamixel-sdk's three calls: least and median calls.

    Ours: targets, gate, goals written, places read, one servo's health read, supervision, tracking.
    dynamixel-sdk: goals written, places read (fast sync read), voltage and temperature of all read
    (sync read; `all_fast`: fast, too); each value fetched as its examples do; no gate, and no
    hardware errors, which lie elsewhere. rustypot, where installed: the same, all fast.
    Thread CPU time of every call, in interleaved blocks of ten, beside peers that answer at once:
    wire time, during which dynamixel-sdk polls and we sleep, is left out. It polls while it waits
    for a peer, too: least calls have the least of that, medians the usual. Its LATENCY_TIMER only
    says when it gives up, so it is left as it comes; calls whose answer was lost do not count.
    """
    with ExitStack() as stack:
        clients: dict[str, Client] = {
            "own": stack.enter_context(own_tick()),
            "sdk": SdkTick(stack.enter_context(canned_peer())),
            "sdk_all_fast": SdkTick(stack.enter_context(canned_peer()), all_fast=True),
        }
        if find_spec("rustypot") is not None:
            clients["rustypot"] = RustypotTick(stack.enter_context(canned_peer()))
        spent_us = _calls_us(clients)
    least = {name: min(each) for name, each in spent_us.items()}
    middle = {name: statistics.median(each) for name, each in spent_us.items()}
    figures = {"cpu_tick_us": least["own"], "cpu_tick_median_us": middle["own"]}
    for name in [name for name in clients if name != "own"]:
        key = f"cpu_tick{_KEYS[name]}_ratio"
        figures[key] = least["own"] / least[name]
        figures[f"{key}_median"] = middle["own"] / middle[name]
    return figures


def _calls_us(clients: dict[str, Client]) -> dict[str, list[float]]:
    """CPU time of every call that got its answers, by client, in microseconds."""
    spent_us: dict[str, list[float]] = {name: [] for name in clients}
    n = 0
    for block in range(_WARM_UP_BLOCKS + _BLOCKS):
        for name, client in clients.items():
            for call in range(n, n + _CALLS):
                client.prepare(call)
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


def moving_deg(n: int) -> np.ndarray:
    """Where the joints are wanted in call n: 4 degrees to and fro at 2 Hz, (n_servos,)."""
    return np.asarray(4.0 * np.sin(2.0 * np.pi * 2.0 * n / _RATE_HZ + 0.3 * np.arange(N_SERVOS)))


@contextmanager
def own_tick() -> Iterator["OwnTick"]:
    """A started bridge over twenty servos that a canned peer plays."""
    with canned_peer() as port:
        tick = OwnTick(port)
        with tick.bus:
            tick.bridge.start()
            yield tick


class _Unhurried:
    """A port whose answers may be late: other work of this computer is no fault of the servos."""

    baud_rate = _BAUD_RATE

    def __init__(self, transport: Transport) -> None:
        self.clock = transport.clock
        self.write = transport.write
        self.discard_input = transport.discard_input
        self.close = transport.close
        self._read = transport.read

    def read(self, deadline_s: float) -> bytes:
        """As that of the port, a second later."""
        return self._read(deadline_s + 1.0)


class OwnTick:
    """A bridge as `run` makes it, on a clock that moves 10 ms a tick and waits for nobody."""

    def __init__(self, port: str) -> None:
        model = servo_models()["XL330-M288"]
        joints = [Joint(f"joint_{n}", n, -40.0, 40.0, 300.0) for n in _IDS]
        servos = [MountedServo(joint, model, 1 if n % 2 else -1) for n, joint in enumerate(joints)]
        self._clock = ManualClock()
        self._channel = MemoryTargetChannel()
        self._time_s = 0.0
        self.bus = DynamixelBus(
            servos, lambda: _Unhurried(open_port(port, _BAUD_RATE, self._clock))
        )
        self.bridge = Bridge(self.bus, joints, self._channel, BridgeSettings(_RATE_HZ))

    def prepare(self, n: int) -> None:
        """The next grid time, and a target for the moment after it."""
        self._time_s = max(self._time_s + 1.0 / _RATE_HZ, self._clock.now())
        self._clock.sleep_until(self._time_s)
        self._channel.publish(ServoTargets(self._time_s + 0.5 / _RATE_HZ, moving_deg(n)))

    def work(self) -> object:
        """The tick."""
        return self.bridge.tick(self._time_s)


class _Goals:
    """The same motion as position registers."""

    goals: list[int]

    def prepare(self, n: int) -> None:
        """Twenty registers."""
        self.goals = (2048 + moving_deg(n) * (4096 / 360)).astype(np.int64).tolist()


class SdkTick(_Goals):
    """dynamixel-sdk, as its own examples use it."""

    def __init__(self, port: str, *, all_fast: bool = False) -> None:
        """all_fast: voltage and temperature by a fast read, too, and not by a plain one."""
        import dynamixel_sdk as sdk

        self._success = sdk.COMM_SUCCESS
        self._handler = sdk.PortHandler(port)
        self._handler.openPort()
        self._handler.setBaudRate(_BAUD_RATE)
        packets = sdk.PacketHandler(2.0)
        self._write = sdk.GroupSyncWrite(self._handler, packets, _GOAL, 4)
        self._motion = sdk.GroupSyncRead(self._handler, packets, _MOTION, _MOTION_SIZE)
        self._warmth = sdk.GroupSyncRead(self._handler, packets, _WARMTH, _WARMTH_SIZE)
        for servo_id in _IDS:
            self._write.addParam(servo_id, [0, 8, 0, 0])
            self._motion.addParam(servo_id)
            self._warmth.addParam(servo_id)
        self._ask_warmth = self._warmth.fastSyncRead if all_fast else self._warmth.txRxPacket

    def work(self) -> list[list[int]]:
        """Currents, positions, voltages, temperatures; raises AnswerLost."""
        for servo_id, goal in zip(_IDS, self.goals, strict=True):
            self._write.changeParam(servo_id, list(goal.to_bytes(4, "little")))
        self._write.txPacket()
        try:
            asked = self._motion.fastSyncRead(), self._ask_warmth()
        except IndexError as error:  # it took a late answer for that to another question
            raise AnswerLost from error
        if asked != (self._success, self._success):
            raise AnswerLost
        found = []
        for group, address, size in (
            (self._motion, _MOTION, 2),
            (self._motion, _MOTION + 6, 4),
            (self._warmth, _WARMTH, 2),
            (self._warmth, _WARMTH + 2, 1),
        ):
            found.append(
                [
                    group.getData(servo_id, address, size)
                    for servo_id in _IDS
                    if group.isAvailable(servo_id, address, size)
                ]
            )
        return found


class RustypotTick(_Goals):
    """rustypot; spans come as bytes, both of them by fast reads."""

    def __init__(self, port: str) -> None:
        import rustypot

        self._bus = rustypot.Xl330PyController(port, _BAUD_RATE, 0.1)
        self._bus.set_fast_sync_read(True)

    def work(self) -> list[list[int]]:
        """Currents, positions, voltages, temperatures."""
        self._bus.sync_write_raw_goal_position(_IDS, self.goals)
        motion = self._read(_MOTION, _MOTION_SIZE, _MOTION_TYPE)
        warmth = self._read(_WARMTH, _WARMTH_SIZE, _WARMTH_TYPE)
        return [
            motion["current"].tolist(),
            motion["position"].tolist(),
            warmth["voltage"].tolist(),
            warmth["temperature"].tolist(),
        ]

    def _read(self, address: int, size: int, kind: np.dtype) -> np.ndarray:
        data = self._bus.sync_read_raw_data(_IDS, address, size)
        return np.frombuffer(b"".join([bytes(each) for each in data]), dtype=kind)


@contextmanager
def canned_peer() -> Iterator[str]:
    """The port of a process that answers for twenty servos, with changing bytes, at once."""
    command = [sys.executable, "-m", "firmware_bridge.simulator.canned_peer", str(N_SERVOS)]
    with subprocess.Popen(
        [*command, str(_MOTION_SIZE)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as peer:
        assert peer.stdout is not None
        yield peer.stdout.readline().strip()
        peer.terminate()
