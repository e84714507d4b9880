"""What the servo bus gives: against the wire, with faults, and after the plug was pulled.

Processor time of the bare line with prepared packets, beside dynamixel-sdk.

What users run, a whole tick, is `tick_cpu_figures`.
"""

import statistics
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from firmware_bridge.bus import ServoState
from firmware_bridge.clock import MonotonicClock, ticks
from firmware_bridge.dynamixel.bus import DynamixelBus
from firmware_bridge.dynamixel.control_table import servo_models
from firmware_bridge.dynamixel.mounting import MountedServo
from firmware_bridge.dynamixel.wire.codec import CommonFrame, GoalWrite, SpanRead, Status
from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.dynamixel.wire.span_group import SpanGroup
from firmware_bridge.joints import Joint
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets
from firmware_bridge.process.operating_system import on_time
from firmware_bridge.serial_servos.serial_transport import open_port
from firmware_bridge.transport import Transport
from lipservo.runtime.servos.sim_process import simulated_port
from lipservo_lab.bench.bus.host_witness import HostWitness
from lipservo_lab.bench.bus.servo_clients import canned_peer
from lipservo_lab.bench.bus.tick_cpu_figures import N_SERVOS
from lipsync.errors import UserError

#: present_current, present_velocity, present_position
_ADDRESS, _SIZE = 126, 10
_IDS = list(range(1, N_SERVOS + 1))
_MOTION = np.dtype([("current", "<i2"), ("velocity", "<i4"), ("position", "<i4")])
_MOTION_BLOCK = CommonFrame.block_of(_MOTION)
_ROUNDS, _CALLS = 25, 40
_MODEL = servo_models()["XL330-M288"]
_CENTER = _MODEL.center_pulse
#: What a stall has left waiting in the line is out of the way so much later.
_AFTER_STALL_S = 0.05


def cpu_ratios() -> dict[str, float]:
    """Return our processor time over that of dynamixel-sdk: for a write, a read, a cycle of both.

    Only packing, sending and decoding are compared, without limits and supervision. Instead of
    servos a process answers at once with prepared packets. A read gets a frame from each servo; the
    cycle's read is a fast one, with one frame for all. Each time is the least of interleaved
    rounds: medians would include the SDK's polling, which depends on the computer's load.
    """
    with ExitStack() as peers:
        calls = _our_calls(peers.enter_context(canned_peer(N_SERVOS)))
        calls |= _sdk_calls(peers.enter_context(canned_peer(N_SERVOS)))
        times_us: dict[str, list[float]] = {name: [] for name in calls}
        for _ in range(_ROUNDS):
            for name, call in calls.items():
                times_us[name].append(_cpu_us(call))
    least_us = {name: min(each) for name, each in times_us.items()}
    kinds = {"sync_write": "write", "sync_read": "read", "cycle": "cycle"}
    return {
        f"cpu_{kind}_ratio": least_us[f"own {call}"] / least_us[f"sdk {call}"]
        for kind, call in kinds.items()
    }


def _our_calls(port: str) -> dict[str, Callable[[], object]]:
    """Return three calls of our serial line: write goals, read 3 values of all servos, and both.

    The read gets a frame from each servo; the cycle reads all servos in one frame. port: of a peer
    that answers for `N_SERVOS` servos.
    """
    line = Line(_NoWire(open_port(port, 4_000_000)), return_delay_s=0.0)
    goals = np.full(N_SERVOS, _CENTER)
    one_by_one = SpanRead(_IDS, _ADDRESS, _SIZE, fast=False)
    joint = SpanRead(_IDS, _ADDRESS, _SIZE, fast=True)

    goal_write = GoalWrite(_IDS, 116)

    def write() -> None:
        line.tell(goal_write.request(goals))

    def read(span: SpanRead = one_by_one) -> list[list[int]]:
        return decode(line.sync_read(span))

    def cycle() -> None:
        write()
        read(joint)

    return {"own write": write, "own read": read, "own cycle": cycle}


def decode(answers: Sequence[Status]) -> list[list[int]]:
    """Return currents, velocities and positions, in registers' units, of servos that answered."""
    if isinstance(answers, CommonFrame):
        values = CommonFrame.blocks(answers.stream, _MOTION_BLOCK)
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
    """Return the same three calls by dynamixel-sdk, written as its own examples are."""
    import dynamixel_sdk as sdk

    handler = sdk.PortHandler(port)
    handler.openPort()
    handler.setBaudRate(4_000_000)
    packets = sdk.PacketHandler(2.0)
    group_write = sdk.GroupSyncWrite(handler, packets, 116, 4)
    group_read = sdk.GroupSyncRead(handler, packets, _ADDRESS, _SIZE)
    for servo_id in _IDS:
        # 2048, the middle position, low byte first.
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


def _cpu_us(call: Callable[[], object], n_calls: int = _CALLS) -> float:
    start_s = time.process_time()
    for _ in range(n_calls):
        call()
    return (time.process_time() - start_s) / n_calls * 1e6


BAUD_RATE = 1_000_000
_SILENT = "faults: [{kind: silence, servos: [7], at_s: [0.0]}]"
_SILENT_ID = 8
_REPLUG_RATE_HZ = 50.0


def scheduling() -> str:
    """Return the scheduling class under which wire and fault figures are taken, as `chrt` does."""
    with on_time() as granted:
        return "SCHED_FIFO" if granted else "SCHED_OTHER"


def wire_figures(seconds: float = 4.0) -> dict[str, float]:
    """Compare a read, and repeated cycles of write and read, with the time their bytes need.

    `read_to_wire_ratio`: median duration of a fast read over its time on the wire.
    `rate_to_wire_ratio`: cycles a second over the most that the wire allows. `rate_cpu_percent`:
    processor time of these cycles, percent of a core. Goals are packed and positions decoded, but
    there are no limits and no supervision.
    """
    with on_time(), _simulated_line(BAUD_RATE) as line:
        span = SpanRead(_IDS, _ADDRESS, _SIZE, fast=True)
        read_wire_s = (len(span.request) + span.reply_size) * line.byte_s
        goals, swing = GoalWrite(_IDS, 116), 100.0 * np.sin(0.3 * np.arange(N_SERVOS))
        for _ in range(100):
            line.sync_read(span)
        elapsed_s = []
        for _ in range(200):
            time.sleep(0.002)
            start_s = time.monotonic()
            line.sync_read(span)
            elapsed_s.append(time.monotonic() - start_s)
        cycle_wire_s = read_wire_s + len(goals.request(swing)) * line.byte_s
        start_s, cpu_s, n = time.monotonic(), time.process_time(), 0
        while time.monotonic() - start_s < seconds:
            line.tell(goals.request(_CENTER + np.rint(swing * np.sin(0.05 * n))))
            decode(line.sync_read(span))
            n += 1
        wall_s = time.monotonic() - start_s
        return {
            "read_to_wire_ratio": statistics.median(elapsed_s) / read_wire_s,
            "rate_to_wire_ratio": n / wall_s * cycle_wire_s,
            "rate_cpu_percent": (time.process_time() - cpu_s) / wall_s * 100.0,
        }


def fault_figures(n_cycles: int = 1_000) -> dict[str, float]:
    """Read servos while one of them is silent, then while one reply in a hundred is lost.

    `..._samples`: share of the expected answers that came; `..._over_wire_ms`: 99th percentile of
    how much longer a cycle takes than its bytes need; `..._kept`: share of cycles that count, which
    are those without a stall of the computer in them or just before.
    """
    others = [each for each in _IDS if each != _SILENT_ID]
    lost_packets = "seed: 1\nfaults: [{kind: drop_reply, probability: 0.01}]"
    share, over_ms, kept = _measure_reads(_SILENT, others, n_cycles)
    figures = {"silent_samples": share, "silent_over_wire_ms": over_ms, "silent_kept": kept}
    share, over_ms, kept = _measure_reads(lost_packets, _IDS, n_cycles)
    return {**figures, "loss_samples": share, "loss_p99_over_wire_ms": over_ms, "loss_kept": kept}


@contextmanager
def _line_with_faults(script: str) -> Iterator[Line]:
    """Yield a line to simulated servos with faults, after 200 reads of those that answer.

    By these reads the line has learnt how late this computer is. script: YAML of the faults.
    """
    with TemporaryDirectory() as folder:
        path = Path(folder) / "faults.yaml"
        path.write_text(script)
        with on_time(), _simulated_line(BAUD_RATE, "--faults", str(path)) as line:
            answering = [each for each in _IDS if each != _SILENT_ID]
            span = SpanRead(answering, _ADDRESS, _SIZE, fast=False)
            for _ in range(200):
                line.sync_read(span)
            yield line


def _measure_reads(script: str, ids: list[int], n_cycles: int) -> tuple[float, float, float]:
    """Read all servos `n_cycles` times; return (share of answers, 99th percentile of delay, kept).

    Share: answers of `ids` that came, over those expected. Delay: ms beyond the time on the wire.
    Kept: share of the cycles in which, and just before which, the computer did not stall; only
    these count. Raises UserError if there are none. script: YAML of the faults.
    """
    cycles: list[tuple[float, float, int, float]] = []
    with HostWitness.watching() as witness, _line_with_faults(script) as line:
        group = SpanGroup(_IDS, _ADDRESS, _SIZE)
        for _ in range(n_cycles):
            time.sleep(0.002)
            start_s = time.monotonic()
            answers = group.ask(line)
            end_s = time.monotonic()
            wire_s = (len(group.request.request) + group.request.reply_size) * line.byte_s
            n_heard = sum(status.servo_id in ids for status in answers)
            cycles.append((start_s, end_s, n_heard, end_s - start_s - wire_s))
        witness.settle()
    counted = [
        (n_heard, over_s)
        for start_s, end_s, n_heard, over_s in cycles
        if not witness.saw_stall(start_s - _AFTER_STALL_S, end_s)
    ]
    if not counted:
        raise UserError("the computer stood still in every cycle; run it on a quieter one")
    n_heard, over_s = np.array(counted).T
    share = float(n_heard.sum()) / (len(ids) * len(counted))
    return share, float(np.percentile(over_s, 99)) * 1e3, len(counted) / n_cycles


def replug_figures(n_servos: int = 10) -> dict[str, float]:
    """Pull a simulated chain's plug for 2 s; return the seconds from its return until recovery.

    `replug_s`: until all servos are driven; `full_strength_s`: until all have full strength.
    """
    joints = [Joint(f"joint_{n}", n, -40.0, 40.0, 300.0) for n in range(1, n_servos + 1)]
    with TemporaryDirectory() as folder:
        path, link = Path(folder) / "faults.yaml", Path(folder) / "port"
        path.write_text("faults: [{kind: unplug, at_s: [4.0], lasts_s: 2.0}]")
        arguments = ["--servos", str(n_servos), "--link", str(link), "--faults", str(path)]
        with simulated_port([*arguments, "--baud-rate", str(BAUD_RATE), "--on-time"]):
            clock = MonotonicClock()
            channel = MemoryTargetChannel()
            servos = [MountedServo(joint, _MODEL) for joint in joints]
            with DynamixelBus(servos, lambda: open_port(str(link), BAUD_RATE)) as bus:
                bridge = Bridge(
                    bus, joints, channel, BridgeSettings(_REPLUG_RATE_HZ, tolerant=True)
                )
                bridge.start()
                back_s = driven_s = 0.0
                for time_s, late in ticks(clock, _REPLUG_RATE_HZ):
                    channel.publish(ServoTargets(time_s, np.zeros(n_servos)))
                    was_lost = bridge.counts.n_unplugged > 0
                    bridge.tick(time_s, late)
                    if was_lost and not back_s and link.exists():
                        # The link is made anew when the port comes back: its time, as a monotonic
                        # one.
                        back_s = link.lstat().st_mtime - time.time() + clock.now()
                    states = bridge.servo_states
                    driven = bridge.plugged and all(s is ServoState.DRIVEN for s in states)
                    if back_s and driven and not driven_s:
                        driven_s = clock.now()
                    if driven_s and bus.at_full_strength:
                        full_s = clock.now()
                        return {"replug_s": driven_s - back_s, "full_strength_s": full_s - back_s}
    raise AssertionError("unreachable: ticks never end")


@contextmanager
def _simulated_line(baud_rate: int, *arguments: str) -> Iterator[Line]:
    """Yield a line to 20 simulated servos in another process, whose answers take their wire time.

    arguments: further ones of the simulator.
    """
    options = ["--servos", str(N_SERVOS), "--baud-rate", str(baud_rate), "--on-time"]
    with simulated_port([*options, *arguments]) as port:
        transport = open_port(port, baud_rate)
        try:
            yield Line(transport, return_delay_s=0.0)
        finally:
            transport.close()
