"""The bridge process: owns the port, runs the loop on the grid, ends in a defined state."""

import logging
from collections.abc import Callable
from functools import partial
from typing import Final

from firmware_bridge.bus import ServoBus, ServoHealth
from firmware_bridge.clock import MonotonicClock
from firmware_bridge.errors import BusError
from firmware_bridge.loop.bridge import Bridge, face_status
from firmware_bridge.loop.life_cycle import LifeCycle, LifeCycleLinks
from firmware_bridge.loop.report import TickReport
from firmware_bridge.process.control_socket import ControlSocket
from firmware_bridge.process.lifeline import Lifeline
from firmware_bridge.process.operating_system import run_on_time
from firmware_bridge.stopping import ExitStatus, StopRequest

_LOG: Final = logging.getLogger(__name__)


def run_bridge(
    bus: ServoBus,
    bridge: Bridge,
    *,
    control: ControlSocket,
    lifeline: Lifeline,
    stopped: StopRequest | None,
    on_health: Callable[[tuple[ServoHealth, ...]], None] | None = None,
    on_tick: Callable[[TickReport], None] | None = None,
) -> int:
    """Arm and tick until told to stop, by a signal or the control socket; the exit status.

    `bus` is entered here. stopped: what a person had asked of the bridge that died before this one.
    on_health: every ten seconds; on_tick: what each tick did; both return at once. Raises BusError
    when it cannot start.
    """
    if lifeline.closed:
        return ExitStatus.ENDED_WELL  # the supervisor died before it could be noticed
    links = LifeCycleLinks(control, lifeline, partial(face_status, bridge), on_health)
    life = LifeCycle(bridge, MonotonicClock(), links, stopped=stopped)
    began = False
    try:
        with bus, life:
            life.start()
            run_on_time()
            for time_s, late in life.ticks():
                report = bridge.tick(time_s, late)
                if on_tick is not None:
                    on_tick(report)
                if not began and bridge.settled:
                    began = True
                    lifeline.ready()
    except BusError as error:
        if not bridge.failure:
            lifeline.not_started(" ".join(str(error).split()))
            raise
        _LOG.warning("%s", error)
        return ExitStatus.CRITICAL_SERVO_FAILED
    assert life.report is not None
    return ExitStatus.ENDED_WELL if life.report.complete else ExitStatus.UNCONFIRMED
