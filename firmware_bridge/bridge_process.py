"""The bridge process: owns the port, runs the loop on the grid, ends in a defined state."""

import os
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np

from firmware_bridge.bridge import Bridge
from firmware_bridge.bus import ServoBus
from firmware_bridge.clock import MonotonicClock, ticks
from firmware_bridge.control_socket import ControlSocket, StopLevel
from firmware_bridge.process import parent_is_alive, run_on_time
from firmware_bridge.report import TickReport


def run_bridge(
    bus: ServoBus,
    bridge: Bridge,
    *,
    rate_hz: float,
    control: Path,
    stopped: Callable[[], bool],
    parent: int,
    say: Callable[[str], None],
) -> None:
    """Arm and tick until told to stop, by a signal, the control socket, or the parent's death.

    `bus` is entered here. However it ends, torque is off afterwards. FREEZE is no end: the face is
    held where it is until something else is asked. say: a line for the log, when a servo gets into
    trouble or out of it.
    """
    clock = MonotonicClock()
    with ControlSocket(control) as requests, bus:
        bridge.start()
        run_on_time()
        level = StopLevel.SOFT
        troubles = bridge.troubles
        for time_s, late in ticks(clock, rate_hz):
            report = bridge.tick(time_s, late)
            if bridge.troubles != troubles:
                troubles = bridge.troubles
                say("; ".join(troubles) or "every servo is driven again")
            asked = requests.poll(partial(_status, bridge, report))
            if asked is StopLevel.FREEZE:
                bridge.freeze()
            elif asked is not None:
                level = asked
                break
            if stopped() or not parent_is_alive(parent):
                break
        if level is StopLevel.LIMP:
            bridge.stop(StopLevel.LIMP)
        else:
            bridge.ease_to_neutral(clock)  # a frozen face goes limp where it is


def _status(bridge: Bridge, report: TickReport) -> dict[str, object]:
    """What `status` answers: plain values, names with units."""
    status = asdict(bridge.status)
    gate = status.pop("gate")
    states = [state.name.lower() for state in bridge.status.servo_states]
    return {
        **status,
        **{f"{name}_total": int(np.sum(each)) for name, each in gate.items()},
        "servo_states": states,
        "troubles": list(bridge.troubles),
        "pid": os.getpid(),
        "torque_on": report.torque_on,
        "stale": report.stale.name.lower(),
        "target_age_s": round(min(report.target_age_s, 1e9), 3),
        "sent_deg": [round(float(each), 2) for each in report.sent_deg],
    }
