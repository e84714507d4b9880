"""The bridge process: owns the port, runs the loop on the grid, ends in a defined state."""

import os
from collections.abc import Callable
from dataclasses import asdict

import numpy as np

from firmware_bridge.bridge import Bridge
from firmware_bridge.bus import ServoBus, ServoError
from firmware_bridge.clock import MonotonicClock
from firmware_bridge.control_socket import ControlSocket, StopLevel
from firmware_bridge.end_report import ENDED_WELL, NOT_AGAIN, UNCONFIRMED
from firmware_bridge.life_cycle import LifeCycle
from firmware_bridge.lifeline import Lifeline
from firmware_bridge.process import run_on_time
from firmware_bridge.report import TickReport


def run_bridge(
    bus: ServoBus,
    bridge: Bridge,
    *,
    rate_hz: float,
    control: ControlSocket,
    lifeline: Lifeline,
    stopped: StopLevel | None,
    say: Callable[[str], None],
) -> int:
    """Arm and tick until told to stop, by a signal or the control socket; the exit status.

    `bus` is entered here. stopped: what a person had asked of the bridge that died before this one.
    say: a line for the log. Raises BusError when it cannot start.
    """
    if lifeline.closed:
        return ENDED_WELL  # the supervisor died before it could be noticed
    life = LifeCycle(
        bridge,
        MonotonicClock(),
        rate_hz=rate_hz,
        control=control,
        lifeline=lifeline,
        log=say,
        status=lambda: _status(bridge, report),
        stopped=stopped,
    )
    began, report = False, None
    try:
        with bus, life:
            life.start()
            run_on_time()
            for time_s, late in life.ticks():
                report = bridge.tick(time_s, late)
                if report.torque_on and not began:
                    began = True
                    lifeline.ready()
    except ServoError as error:
        if not began:
            raise
        say(str(error))
        return NOT_AGAIN
    confirmed = life.report is not None and not life.report.unconfirmed
    return ENDED_WELL if confirmed else UNCONFIRMED


def _status(bridge: Bridge, report: TickReport | None) -> dict[str, object]:
    """What `status` answers: plain values, names with units; report: of the newest tick."""
    status = asdict(bridge.status)
    gate = status.pop("gate")
    ticked = {}
    if report is not None:
        ticked = {
            "torque_on": report.torque_on,
            "stale": report.stale.name.lower(),
            "target_age_s": round(min(report.target_age_s, 1e9), 3),
            "sent_deg": [round(float(each), 2) for each in report.sent_deg],
        }
    return {
        **status,
        **{f"{name}_total": int(np.sum(each)) for name, each in gate.items()},
        "servo_states": [state.name.lower() for state in bridge.status.servo_states],
        "troubles": list(bridge.troubles),
        "bridge_pid": os.getpid(),
        **ticked,
    }
