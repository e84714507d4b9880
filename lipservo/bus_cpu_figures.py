"""Processor time of the servo bus: ours, dynamixel-sdk and rustypot side by side, in one run."""

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from importlib.util import find_spec

import numpy as np

from firmware_bridge.dynamixel.line import GoalWrite, Line, SpanRead
from firmware_bridge.dynamixel.serial_transport import open_port
from firmware_bridge.dynamixel.transport import Transport

N_SERVOS = 20
#: present_current, present_velocity, present_position
_ADDRESS, _SIZE = 126, 10
_IDS = list(range(1, N_SERVOS + 1))
_MOTION = np.dtype([("current", "<i2"), ("velocity", "<i4"), ("position", "<i4")])
_ROUNDS, _CALLS = 25, 40


def cpu_ratios() -> dict[str, float]:
    """CPU of the same work, ours over the SDK's; over rustypot's too, when that is installed.

    No wire time. The least of interleaved rounds each: what a library cannot do without, whatever
    else the computer does; the SDK, which polls, would look worse by medians.
    """
    with ExitStack() as peers:
        calls = _own_calls(peers.enter_context(_canned_peer()))
        calls |= _sdk_calls(peers.enter_context(_canned_peer()))
        others = {"": "sdk"}
        if find_spec("rustypot") is not None:
            calls |= _rustypot_calls(peers.enter_context(_canned_peer()))
            others["_rustypot"] = "rustypot"
        spent: dict[str, list[float]] = {name: [] for name in calls}
        for _ in range(_ROUNDS):
            for name, call in calls.items():
                spent[name].append(_cpu_us(call))
    least_us = {name: min(each) for name, each in spent.items()}
    kinds = {"sync_write": "write", "sync_read": "read", "cycle": "cycle"}
    return {
        f"cpu_{kind}_ratio{suffix}": least_us[f"own {call}"] / least_us[f"{other} {call}"]
        for suffix, other in others.items()
        for kind, call in kinds.items()
    }


def _own_calls(port: str) -> dict[str, Callable[[], object]]:
    """Write 20 goals; read 20 x 3 values, a frame each; and both, read in one frame."""
    line = Line(_NoWire(open_port(port, 4_000_000)), return_delay_s=0.0)
    goals = np.full(N_SERVOS, 2048)
    plain = SpanRead(_IDS, _ADDRESS, _SIZE, fast=False)
    fast = SpanRead(_IDS, _ADDRESS, _SIZE, fast=True)

    goal_write = GoalWrite(_IDS, 116)

    def write() -> None:
        line.tell(goal_write.request(goals.tolist()))

    def read(span: SpanRead = plain) -> list[list[int]]:
        values = np.frombuffer(b"".join([s.data for s in line.sync_read(span)]), dtype=_MOTION)
        return [values[name].tolist() for name in ("current", "velocity", "position")]

    def cycle() -> None:
        write()
        read(fast)

    return {"own write": write, "own read": read, "own cycle": cycle}


class _NoWire:
    """A transport whose bytes take no time, so that only work is measured and no waiting."""

    baud_rate = 10**12

    def __init__(self, transport: Transport) -> None:
        self.clock = transport.clock
        self.write = transport.write
        self.read = transport.read
        self.discard_input = transport.discard_input
        self.close = transport.close


def _sdk_calls(port: str) -> dict[str, Callable[[], object]]:
    """The same with dynamixel-sdk, as its own examples do it."""
    import dynamixel_sdk as sdk

    handler = sdk.PortHandler(port)
    handler.openPort()
    handler.setBaudRate(4_000_000)
    packets = sdk.PacketHandler(2.0)
    group_write = sdk.GroupSyncWrite(handler, packets, 116, 4)
    group_read = sdk.GroupSyncRead(handler, packets, _ADDRESS, _SIZE)
    for servo_id in _IDS:
        group_write.addParam(servo_id, [0, 8, 0, 0])
        group_read.addParam(servo_id)

    def write() -> None:
        for servo_id in _IDS:
            group_write.changeParam(servo_id, [0, 8, 0, 0])
        group_write.txPacket()

    def read() -> list[list[int]]:
        group_read.txRxPacket()
        return [
            [group_read.getData(servo_id, address, size) for servo_id in _IDS]
            for address, size in ((126, 2), (128, 4), (132, 4))
        ]

    def cycle() -> None:
        write()
        read()

    return {"sdk write": write, "sdk read": read, "sdk cycle": cycle}


def _rustypot_calls(port: str) -> dict[str, Callable[[], object]]:
    """The same with rustypot, which decodes single registers only: the span comes as bytes."""
    import rustypot

    bus = rustypot.Xl330PyController(port, 4_000_000, 0.1)
    goals = [2048] * N_SERVOS

    def write() -> None:
        bus.sync_write_raw_goal_position(_IDS, goals)

    def read(fast: bool = False) -> list[list[int]]:
        bus.set_fast_sync_read(fast)
        data = b"".join([bytes(each) for each in bus.sync_read_raw_data(_IDS, _ADDRESS, _SIZE)])
        values = np.frombuffer(data, dtype=_MOTION)
        return [values[name].tolist() for name in ("current", "velocity", "position")]

    def cycle() -> None:
        write()
        read(fast=True)

    return {"rustypot write": write, "rustypot read": read, "rustypot cycle": cycle}


@contextmanager
def _canned_peer() -> Iterator[str]:
    command = [sys.executable, "-m", "firmware_bridge.simulator.canned_peer", str(N_SERVOS)]
    with subprocess.Popen(
        [*command, str(_SIZE)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as peer:
        assert peer.stdout is not None
        yield peer.stdout.readline().strip()
        peer.terminate()


def _cpu_us(call: Callable[[], object], n_calls: int = _CALLS) -> float:
    start_s = time.process_time()
    for _ in range(n_calls):
        call()
    return (time.process_time() - start_s) / n_calls * 1e6
