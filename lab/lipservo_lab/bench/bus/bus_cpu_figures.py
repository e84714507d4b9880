"""Processor time of the bare line with prepared packets, beside dynamixel-sdk and rustypot.

What users run, a whole tick, is `tick_cpu_figures`.
"""

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from importlib.util import find_spec

import numpy as np

from firmware_bridge.dynamixel.wire.codec import Status
from firmware_bridge.dynamixel.wire.line import GoalWrite, Line, SpanRead
from firmware_bridge.dynamixel.wire.prepared_packets import CommonFrame
from firmware_bridge.dynamixel.wire.serial_transport import open_port
from firmware_bridge.dynamixel.wire.transport import Transport
from lipservo_lab.bench.bus.servo_clients import canned_peer
from lipservo_lab.bench.bus.tick_cpu_figures import N_SERVOS

#: present_current, present_velocity, present_position
_ADDRESS, _SIZE = 126, 10
_IDS = list(range(1, N_SERVOS + 1))
_MOTION = np.dtype([("current", "<i2"), ("velocity", "<i4"), ("position", "<i4")])
_MOTION_BLOCK = CommonFrame.block_of(_MOTION)
_ROUNDS, _CALLS = 25, 40


def cpu_ratios() -> dict[str, float]:
    """CPU of the same work, the bare line over the SDK; over rustypot, too, when it is installed.

    Writes, reads of a frame each, and a cycle: a write and a fast read, on either side. No gate, no
    supervision; our packets are prepared. No wire time. The least of interleaved rounds each: what
    a library cannot do without, whatever else the computer does; the SDK, which polls, would look
    worse by medians.
    """
    with ExitStack() as peers:
        calls = _own_calls(peers.enter_context(canned_peer(N_SERVOS)))
        calls |= _sdk_calls(peers.enter_context(canned_peer(N_SERVOS)))
        others = {"": "sdk"}
        if find_spec("rustypot") is not None:
            calls |= _rustypot_calls(peers.enter_context(canned_peer(N_SERVOS)))
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
        line.tell(goal_write.request(goals))

    def read(span: SpanRead = plain) -> list[list[int]]:
        return decode(line.sync_read(span))

    def cycle() -> None:
        write()
        read(fast)

    return {"own write": write, "own read": read, "own cycle": cycle}


def decode(answers: Sequence[Status]) -> list[list[int]]:
    """Currents, velocities and positions of those who answered."""
    if isinstance(answers, CommonFrame):
        values = answers.values(_MOTION_BLOCK)
    else:
        values = np.frombuffer(b"".join([each.data for each in answers]), dtype=_MOTION)
    return [values[name].tolist() for name in ("current", "velocity", "position")]


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

    def read(ask: Callable[[], int] = group_read.txRxPacket) -> list[list[int]]:
        ask()
        return [
            [group_read.getData(servo_id, address, size) for servo_id in _IDS]
            for address, size in ((126, 2), (128, 4), (132, 4))
        ]

    def cycle() -> list[list[int]]:
        write()
        return read(group_read.fastSyncRead)

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


def _cpu_us(call: Callable[[], object], n_calls: int = _CALLS) -> float:
    start_s = time.process_time()
    for _ in range(n_calls):
        call()
    return (time.process_time() - start_s) / n_calls * 1e6
