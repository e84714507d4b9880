"""The endurance run in numbers."""

import time
from collections.abc import Callable
from dataclasses import asdict

from firmware_bridge.simulator.endurance import endure

#: As many as a mouth needs; more servos cost time, and leak nothing else.
N_SERVOS, RATE_HZ = 5, 100.0


def endurance_figures(
    n_cycles: int, progress: Callable[[int], None], stopped: Callable[[], bool]
) -> dict[str, float]:
    """Run `n_cycles` and say what grew, what went wrong on the wire, and how fast it went."""
    cpu_s = time.process_time()
    result = endure(n_cycles, progress, n_servos=N_SERVOS, rate_hz=RATE_HZ, stopped=stopped)
    cpu_s = time.process_time() - cpu_s
    return {
        **asdict(result),
        "servos": N_SERVOS,
        "rate_hz": RATE_HZ,
        "cycles_per_cpu_second": result.cycles / cpu_s,
    }
