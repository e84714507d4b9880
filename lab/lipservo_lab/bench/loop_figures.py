"""How late the loop runs while other processes keep every core busy."""

import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext

import numpy as np

from firmware_bridge.clock import MonotonicClock, ticks
from firmware_bridge.dynamixel.bus import DynamixelBus
from firmware_bridge.dynamixel.control_table import servo_models
from firmware_bridge.dynamixel.mounting import MountedServo
from firmware_bridge.joints import Joint
from firmware_bridge.loop.bridge import Bridge
from firmware_bridge.loop.report import BridgeSettings
from firmware_bridge.loop.targets import MemoryTargetChannel, ServoTargets
from firmware_bridge.process.operating_system import on_time
from firmware_bridge.serial_servos.serial_transport import open_port
from firmware_bridge.stopping import StopLevel
from lipservo.runtime.servos.sim_process import simulated_port
from lipservo.runtime.summary import Histogram

RATES_HZ = (30.0, 100.0, 200.0)
_WINDOWS = 4
_N_SERVOS, _BAUD_RATE = 10, 1_000_000

#: The work of a tick, given its time and how many were missed before it.
Tick = Callable[[float, int], object]


def lateness_figures(
    seconds: float, progress: Callable[[int, int], None], *, with_bus: bool = False
) -> dict[str, float]:
    """99th percentile of the lateness by rate and scheduling, in ms; each over `seconds`.

    `_median_`: of the percentiles of four windows, which one stall of the computer does not move.
    `_fifo` is left out where the computer does not permit it. Without a bus: what the computer adds
    before a tick can begin. with_bus, names end in `_bus`: bridge, gate and ten simulated servos
    behind a pseudo-terminal in every tick; a tick begins late, too, after a long one.
    """
    figures = {}
    runs = [(fifo, rate_hz) for fifo in (False, True) for rate_hz in RATES_HZ]
    with _hogs():
        for n, (fifo, rate_hz) in enumerate(runs):
            progress(n, len(runs))
            suffix = ("_fifo" if fifo else "") + ("_bus" if with_bus else "")
            tick = _driven_servos(rate_hz) if with_bus else nullcontext(lambda *_: None)
            with tick as work, on_time() if fifo else nullcontext(True) as granted:
                if not granted:
                    continue
                whole_ms, windows_ms = _lateness_p99_ms(rate_hz, seconds, work)
            figures[f"lateness_p99_ms_{rate_hz:.0f}{suffix}"] = whole_ms
            figures[f"lateness_p99_median_ms_{rate_hz:.0f}{suffix}"] = windows_ms
    return figures


def _lateness_p99_ms(rate_hz: float, seconds: float, work: Tick) -> tuple[float, float]:
    """Return p99 of all ticks, and the median of the windows' p99, ms."""
    clock = MonotonicClock()
    whole, windows = Histogram(), [Histogram() for _ in range(_WINDOWS)]
    start_s = clock.now()
    for time_s, late in ticks(clock, rate_hz):
        now_s = clock.now()
        window = int((time_s - start_s) / seconds * _WINDOWS)
        if window >= _WINDOWS:
            break
        for missed in range(late + 1):
            for histogram in (whole, windows[window]):
                histogram.add(now_s - time_s + missed / rate_hz)
        work(time_s, late)
    return whole.percentile_ms(99), statistics.median(each.percentile_ms(99) for each in windows)


@contextmanager
def _driven_servos(rate_hz: float) -> Iterator[Tick]:
    """Ten simulated servos in a process of their own, and the tick that drives them."""
    model = servo_models()["XL330-M288"]
    joints = [Joint(f"joint_{n}", n, -40.0, 40.0, 300.0) for n in range(1, _N_SERVOS + 1)]
    servos = [MountedServo(joint, model) for joint in joints]
    channel = MemoryTargetChannel()
    options = ["--servos", str(_N_SERVOS), "--baud-rate", str(_BAUD_RATE), "--on-time"]
    with (
        simulated_port(options) as port,
        DynamixelBus(servos, lambda: open_port(port, _BAUD_RATE)) as bus,
    ):
        bridge = Bridge(bus, joints, channel, BridgeSettings(rate_hz, tolerant=True))
        bridge.start()

        def tick(time_s: float, late: int) -> None:
            wanted_deg = np.full(_N_SERVOS, 20.0 * np.sin(2.0 * np.pi * time_s))
            channel.publish(ServoTargets(time_s, wanted_deg))
            bridge.tick(time_s, late)

        yield tick
        bridge.stop(StopLevel.LIMP)


@contextmanager
def _hogs() -> Iterator[None]:
    """One busy process a core."""
    # Without end, but not without this process.
    hog = "import os; parent = os.getppid()\nwhile os.getppid() == parent: pass"
    command = [sys.executable, "-c", hog]
    busy = [subprocess.Popen(command) for _ in range(os.cpu_count() or 1)]
    try:
        time.sleep(0.5)
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()
