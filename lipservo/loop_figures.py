"""How late the loop runs while other processes keep every core busy."""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext

from firmware_bridge.clock import MonotonicClock, ticks
from firmware_bridge.process import on_time
from lipservo.summary import Histogram

RATES_HZ = (30.0, 100.0, 200.0)


def lateness_figures(seconds: float = 5.0) -> dict[str, float]:
    """99th percentile of the lateness by rate and scheduling, in ms.

    Measured in this process without a bus: what the computer adds before a tick can begin. `_fifo`
    is left out where the computer does not permit it.
    """
    figures = {}
    with _hogs():
        for fifo in (False, True):
            with on_time() if fifo else nullcontext(True) as granted:
                if not granted:
                    continue
                for rate_hz in RATES_HZ:
                    name = f"lateness_p99_ms_{rate_hz:.0f}" + ("_fifo" if fifo else "")
                    figures[name] = _lateness_p99_ms(rate_hz, seconds)
    return figures


def _lateness_p99_ms(rate_hz: float, seconds: float) -> float:
    clock, histogram = MonotonicClock(), Histogram()
    end_s = clock.now() + seconds
    for time_s, late in ticks(clock, rate_hz):
        for missed in range(late):
            histogram.add(clock.now() - time_s + (missed + 1) / rate_hz)
        histogram.add(clock.now() - time_s)
        if time_s > end_s:
            return histogram.percentile_ms(99)
    raise AssertionError("unreachable: ticks never end")


@contextmanager
def _hogs() -> Iterator[None]:
    """One busy process a core."""
    command = [sys.executable, "-c", "while True: pass"]
    busy = [subprocess.Popen(command) for _ in range(os.cpu_count() or 1)]
    try:
        time.sleep(0.5)
        yield
    finally:
        for process in busy:
            process.kill()
            process.wait()
