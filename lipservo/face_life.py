"""The life cycle of one face as every command starts it, and how a command ends after it."""

from collections.abc import Callable

from firmware_bridge.bridge import Bridge
from firmware_bridge.clock import Clock
from firmware_bridge.life_cycle import LifeCycle
from firmware_bridge.stopping import StopReport
from lipservo.output import MESSAGES

#: Exit status of a stop that not every servo confirmed; a service is not started again after it.
UNCONFIRMED = 3


class FaceStopped(Exception):  # noqa: N818 - what a person asked for is no error
    """Somebody stopped the face before the command was done; carries what the servos said."""

    def __init__(self, report: StopReport, signal_number: int | None) -> None:
        super().__init__(report.text())
        self.report = report
        self.signal_number = signal_number


def face_life(
    bridge: Bridge,
    clock: Clock,
    rate_hz: float,
    *,
    log: Callable[[str], None] = lambda _line: None,
) -> LifeCycle:
    """The life cycle of a face that this process drives."""
    return LifeCycle(bridge, clock, rate_hz=rate_hz, log=log)


def exit_status(report: StopReport, signal_number: int | None) -> int:
    """0; after a signal 128 + its number, as shells count; 3 when a servo did not confirm."""
    if not report.complete:
        return UNCONFIRMED
    return 0 if signal_number is None else 128 + signal_number


def say(line: str) -> None:
    """Print one line for people on stderr."""
    MESSAGES.print(line, soft_wrap=True, highlight=False, markup=False)
