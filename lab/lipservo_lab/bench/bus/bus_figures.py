"""What the servo bus gives: against the wire, with faults, and after the plug was pulled."""

import statistics
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from firmware_bridge.clock import MonotonicClock, ticks
from firmware_bridge.dynamixel.bus import DynamixelBus
from firmware_bridge.dynamixel.control_table import servo_models
from firmware_bridge.dynamixel.mounting import MountedServo
from firmware_bridge.dynamixel.wire import codec
from firmware_bridge.dynamixel.wire.line import GoalWrite, Line, SpanRead
from firmware_bridge.dynamixel.wire.serial_transport import open_port
from firmware_bridge.dynamixel.wire.span_group import SpanGroup
from firmware_bridge.health import ServoState
from firmware_bridge.joints import Joint
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.channel import MemoryTargetChannel
from firmware_bridge.loop.settings import BridgeSettings
from firmware_bridge.process.scheduling import on_time
from firmware_bridge.targets import ServoTargets
from lipservo.face.sim_process import simulated_port
from lipservo_lab.bench.bus.bus_cpu_figures import decode

N_SERVOS = 20
BAUD_RATE = 1_000_000
#: present_current, present_velocity, present_position
_ADDRESS, _SIZE = 126, 10
_IDS = list(range(1, N_SERVOS + 1))
#: torque_enable .. bus_watchdog: what a tick reads of one servo, the next in turn.
_HEALTH_ADDRESS, _HEALTH_SIZE = 64, 35
_SILENT = "faults: [{kind: silence, servos: [7], at_s: [0.0]}]"
_SILENT_ID = 8
_REPLUG_RATE_HZ = 50.0


def scheduling() -> str:
    """The class that wire and fault figures are measured in, as `chrt` names it."""
    with on_time() as granted:
        return "SCHED_FIFO" if granted else "SCHED_OTHER"


def wire_figures(seconds: float = 4.0) -> dict[str, float]:
    """Reads against their time on the wire; write and read as fast as they go, with the CPU.

    The bare line: goals that change are packed, places decoded; no gate, no supervision.
    """
    with on_time(), _simulated(BAUD_RATE) as line:
        span = SpanRead(_IDS, _ADDRESS, _SIZE, fast=True)
        read_wire_s = (len(span.request) + span.reply_size) * line.byte_s
        goals, swing = GoalWrite(_IDS, 116), 100.0 * np.sin(0.3 * np.arange(N_SERVOS))
        for _ in range(100):
            line.sync_read(span)
        took_s = []
        for _ in range(200):
            time.sleep(0.002)
            start_s = time.monotonic()
            line.sync_read(span)
            took_s.append(time.monotonic() - start_s)
        cycle_wire_s = read_wire_s + len(goals.request(swing)) * line.byte_s
        start_s, cpu_s, n = time.monotonic(), time.process_time(), 0
        while time.monotonic() - start_s < seconds:
            line.tell(goals.request(2048.0 + np.rint(swing * np.sin(0.05 * n))))
            decode(line.sync_read(span))
            n += 1
        wall_s = time.monotonic() - start_s
        return {
            "read_to_wire_ratio": statistics.median(took_s) / read_wire_s,
            "rate_to_wire_ratio": n / wall_s * cycle_wire_s,
            "rate_cpu_percent": (time.process_time() - cpu_s) / wall_s * 100.0,
        }


def fault_figures(n_cycles: int = 1_000) -> dict[str, float]:
    """One servo silent, and one packet in a hundred lost: what is heard, and how late."""
    share, over_ms = _heard(_SILENT, [each for each in _IDS if each != _SILENT_ID], n_cycles)
    figures = {"silent_samples": share, "silent_over_wire_ms": over_ms}
    lossy = "seed: 1\nfaults: [{kind: drop_reply, probability: 0.01}]"
    share, over_ms = _heard(lossy, _IDS, n_cycles)
    return {**figures, "loss_samples": share, "loss_p99_over_wire_ms": over_ms}


def silent_cycle_figures(n_cycles: int = 1_200) -> dict[str, float]:
    """Time beyond the wire of the cycles in which a silent servo is asked, in ms: median and most.

    A cycle is what the bus asks in a tick: the places of all, and the health of one, in turns. The
    silent one is asked now and then among all, and whenever it is its turn; the other cycles, 19 of
    20, would hide these in any percentile of all.
    """
    over_ms = []
    with _faulty_line(_SILENT) as line:
        group = SpanGroup(_IDS, _ADDRESS, _SIZE)
        for n in range(n_cycles):
            time.sleep(0.002)
            servo_id = _IDS[n % N_SERVOS]
            question = codec.read(servo_id, _HEALTH_ADDRESS, _HEALTH_SIZE)
            start_s = time.monotonic()
            group.ask(line)
            line.read(servo_id, _HEALTH_ADDRESS, _HEALTH_SIZE)
            took_s = time.monotonic() - start_s
            if servo_id == _SILENT_ID or _SILENT_ID in group.asked.ids:
                n_bytes = len(group.asked.request) + group.asked.reply_size + len(question)
                n_bytes += codec.EMPTY_STATUS_SIZE + _HEALTH_SIZE
                over_ms.append((took_s - n_bytes * line.byte_s) * 1e3)
    return {
        "silent_asked_cycle_median_ms": statistics.median(over_ms),
        "silent_asked_cycle_max_ms": max(over_ms),
        "silent_asked_cycles": len(over_ms),
    }


@contextmanager
def _faulty_line(script: str) -> Iterator[Line]:
    """A line to servos with these faults, which has learnt how late this computer is."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "faults.yaml"
        path.write_text(script)
        with on_time(), _simulated(BAUD_RATE, "--faults", str(path)) as line:
            healthy = [each for each in _IDS if each != _SILENT_ID]
            plain = SpanRead(healthy, _ADDRESS, _SIZE, fast=False)
            for _ in range(200):
                line.sync_read(plain)
            yield line


def _heard(script: str, ids: list[int], n_cycles: int) -> tuple[float, float]:
    """Share of the samples of `ids` that came, and the 99th percentile of time beyond the wire."""
    with _faulty_line(script) as line:
        group = SpanGroup(_IDS, _ADDRESS, _SIZE)
        n_heard, over_s = 0, []
        for _ in range(n_cycles):
            time.sleep(0.002)
            start_s = time.monotonic()
            answers = group.ask(line)
            took_s = time.monotonic() - start_s
            wire_s = (len(group.asked.request) + group.asked.reply_size) * line.byte_s
            over_s.append(took_s - wire_s)
            n_heard += sum(status.servo_id in ids for status in answers)
    return n_heard / (len(ids) * n_cycles), float(np.percentile(over_s, 99)) * 1e3


def replug_figures(n_servos: int = 10) -> dict[str, float]:
    """From the moment a port is back: until every servo is driven again, and at full strength."""
    model = servo_models()["XL330-M288"]
    joints = [Joint(f"joint_{n}", n, -40.0, 40.0, 300.0) for n in range(1, n_servos + 1)]
    with TemporaryDirectory() as folder:
        path, link = Path(folder) / "faults.yaml", Path(folder) / "port"
        path.write_text("faults: [{kind: unplug, at_s: [4.0], lasts_s: 2.0}]")
        arguments = ["--servos", str(n_servos), "--link", str(link), "--faults", str(path)]
        with simulated_port([*arguments, "--baud-rate", str(BAUD_RATE), "--on-time"]):
            clock = MonotonicClock()
            channel = MemoryTargetChannel()
            servos = [MountedServo(joint, model) for joint in joints]
            with DynamixelBus(servos, lambda: open_port(str(link), BAUD_RATE)) as bus:
                bridge = Bridge(
                    bus, joints, channel, BridgeSettings(_REPLUG_RATE_HZ, tolerant=True)
                )
                bridge.start()
                back_s = driven_s = 0.0
                for time_s, late in ticks(clock, _REPLUG_RATE_HZ):
                    channel.publish(ServoTargets(time_s, np.zeros(n_servos)))
                    before = bridge.status
                    bridge.tick(time_s, late)
                    if before.n_unplugged and not back_s and link.exists():
                        back_s = link.lstat().st_mtime - time.time() + clock.now()
                    states = bridge.status.servo_states
                    driven = bridge.plugged and all(s is ServoState.DRIVEN for s in states)
                    if back_s and driven and not driven_s:
                        driven_s = clock.now()
                    if driven_s and bus.at_full_strength:
                        full_s = clock.now()
                        return {"replug_s": driven_s - back_s, "full_strength_s": full_s - back_s}
    raise AssertionError("unreachable: ticks never end")


@contextmanager
def _simulated(baud_rate: int, *arguments: str) -> Iterator[Line]:
    """A line to twenty simulated servos in a process of their own, with wire time."""
    options = ["--servos", str(N_SERVOS), "--baud-rate", str(baud_rate), "--on-time"]
    with simulated_port([*options, *arguments]) as port:
        transport = open_port(port, baud_rate)
        try:
            yield Line(transport, return_delay_s=0.0)
        finally:
            transport.close()
