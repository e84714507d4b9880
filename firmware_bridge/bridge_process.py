"""The bridge process: owns the port, runs the loop on the grid, ends in a defined state."""

from collections.abc import Callable

from firmware_bridge.bridge import Bridge
from firmware_bridge.bus import ServoBus, ServoError
from firmware_bridge.clock import MonotonicClock
from firmware_bridge.control_socket import ControlSocket, StopLevel
from firmware_bridge.end_report import ENDED_WELL, NOT_AGAIN, UNCONFIRMED
from firmware_bridge.life_cycle import LifeCycle
from firmware_bridge.lifeline import Lifeline
from firmware_bridge.process import run_on_time


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
        say=say,
        stopped=stopped,
    )
    began = False
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
    say(life.report.text())
    return UNCONFIRMED if life.report.unconfirmed else ENDED_WELL
