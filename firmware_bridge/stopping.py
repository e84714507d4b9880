"""Stop levels, orders to a running face, the report of a stop, and the exit status."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum, StrEnum
from typing import Final

from firmware_bridge.capabilities import BusCapabilities

#: A stop by a signal waits so long for a lost port, to switch torque off once it is back.
PORT_WAIT_S: Final = 30.0
#: Why a start is refused until the supervisor has reported the end of the stop.
START_WHILE_STOPPING: Final = "the face is stopping: start it once its servos are confirmed limp"


class StopLevel(StrEnum):
    """The level of a stop: ease to neutral and then limp, hold the position, or limp at once."""

    SOFT = "soft"  # ease to neutral, then let go
    FREEZE = "freeze"  # stay, held, until another level is asked for
    LIMP = "limp"  # let go now


@dataclass(frozen=True, slots=True)
class StopRequest:
    """A stop that was requested, with its level.

    requested_by: a process and its user, for a log. ends: the process ends with the stop; otherwise
    a daemon waits, limp, for a start.
    """

    level: StopLevel
    requested_by: str = ""
    ends: bool = False


class ExitStatus(IntEnum):
    """The exit status of a process that drove servos; 1 and 2 are left to errors and bad usage."""

    ENDED_WELL = 0
    #: It ended as asked, but not every servo confirmed to be limp.
    UNCONFIRMED = 3
    #: Starting again would not help.
    CRITICAL_SERVO_FAILED = 4
    #: A person stopped it, and all servos confirmed, before its work was done: nothing was written.
    STOPPED_EARLY = 5


@dataclass(frozen=True, slots=True)
class StopReport:
    """The torque states that the servos themselves reported at a stop.

    confirmed: servos, by name, that were read with torque off. unconfirmed: why others were not, by
    name. released: servos that were sent torque off on a bus where they cannot confirm it;
    released_words: their state then, in words.
    at_rest: whether the face had come to neutral before; None: not known, since the process that
    switched torque off had not moved it. dry_run: no torque was ever switched on. confirms: whether
    there are servos that can confirm torque off.
    """

    confirmed: tuple[str, ...] = ()
    unconfirmed: Mapping[str, str] = field(default_factory=dict)
    at_rest: bool | None = None
    dry_run: bool = False
    released: tuple[str, ...] = ()
    released_words: str = ""
    confirms: bool = True

    @property
    def complete(self) -> bool:
        """Whether every servo that can confirm torque off did; the others were sent torque off."""
        return not self.unconfirmed

    @property
    def log_level(self) -> int:
        """The level for `logging`: INFO if the report is complete, else WARNING."""
        return logging.INFO if self.complete else logging.WARNING

    def text(self) -> str:
        """Return the report for a person: one line, and one for each servo that did not confirm."""
        if self.dry_run:
            return "dry run over; no torque was switched on"
        if self.released and self.complete:
            return f"stopped; {'at rest, ' if self.at_rest else ''}{self.line()}"
        where = "at rest and limp" if self.at_rest else "limp"
        n = len(self.confirmed)
        if self.complete:
            return f"stopped; the face is {where}: confirmed by {_servos(n)}"
        n_left = _servos(len(self.unconfirmed))
        lines = [f"torque off was confirmed by {_servos(n)}, NOT by {n_left}:"]
        if not self.confirms:
            lines = [f"{n_left} may still be driven:"]
        lines += [f"  {name}: {why}" for name, why in self.unconfirmed.items()]
        if self.released:
            lines.append(f"{_servos(len(self.released))} let go: {self.released_words}")
        reached = "`lipservo limp` lets go what can be reached"
        lines.append(f"keep your hands away; {reached if self.confirms else 'take their power'}")
        return "\n".join(lines)

    def line(self) -> str:
        """Return one line for a log: which servos confirmed torque off, and which did not, and why.

        Unlike `text` it does not say that the face has stopped.
        """
        n = len(self.confirmed)
        if self.released and self.complete:
            let_go = f"{_servos(len(self.released))} let go, not confirmed: {self.released_words}"
            return f"{let_go}; torque off confirmed by {_servos(n)}" if n else let_go
        if self.complete:
            return f"torque off confirmed by all {n} servos"
        left = named_by_reason(self.unconfirmed)
        if not self.confirms:
            return f"may still be driven: {left}"
        return f"torque off confirmed by {n} servos, NOT by {left}"

    def as_dict(self) -> dict[str, object]:
        """Return the report for JSON and for the client that requested the stop.

        `released` is contained only where servos cannot confirm.
        """
        released = {"released": list(self.released), "released_words": self.released_words}
        return {
            "complete": self.complete,
            "at_rest": self.at_rest,
            "dry_run": self.dry_run,
            "confirmed": list(self.confirmed),
            "unconfirmed": dict(self.unconfirmed),
            **(released if self.released else {}),
        }


def let_go_report(
    let_go: Mapping[str, BusCapabilities],
    unconfirmed: Mapping[str, str],
    *,
    at_rest: bool | None = None,
    dry_run: bool = False,
    confirms: bool = True,
) -> StopReport:
    """Return the report of a stop.

    let_go: capabilities, by name, of the servos that are limp or were sent torque off. unconfirmed:
    why other servos did not confirm, by name. Other arguments as in `StopReport`.
    """
    confirmed = tuple(name for name, can in let_go.items() if can.confirmed_limp)
    released = {name: can.released_words for name, can in let_go.items() if name not in confirmed}
    words = "; ".join(dict.fromkeys(released.values()))
    return StopReport(confirmed, unconfirmed, at_rest, dry_run, tuple(released), words, confirms)


def named_by_reason(unconfirmed: Mapping[str, str]) -> str:
    """Return reasons by servo as text, each reason once: `jaw, left: does not answer; lip: ...`."""
    servos: dict[str, list[str]] = {}
    for name, why in unconfirmed.items():
        servos.setdefault(why, []).append(name)
    return "; ".join(f"{', '.join(names)}: {why}" for why, names in servos.items())


def _servos(n: int) -> str:
    return "1 servo" if n == 1 else f"{n} servos"


class ServoSwitch(StrEnum):
    """The orders to switch one servo: off, on, reboot."""

    OFF = "off"  # torque off, and it stays off until ON
    ON = "on"  # tried again, also after it was given up
    REBOOT = "reboot"


@dataclass(frozen=True, slots=True)
class ServoOrder:
    """The order to switch the servo `name`. requested_by: process and user, for a log."""

    name: str
    switch: ServoSwitch
    requested_by: str = ""

    def __str__(self) -> str:
        return f"servo {self.name} {self.switch.value}"


@dataclass(frozen=True, slots=True)
class ArmJog:
    """The order to start or prolong jogging: moving single joints by command while a face runs.

    Jogging ends some seconds after the last order.
    """


@dataclass(frozen=True, slots=True)
class JogTo:
    """The order to jog joint `name` to an angle, in joint degrees, where it stays."""

    name: str
    position_deg: float


@dataclass(frozen=True, slots=True)
class JogPulse:
    """The order to jog hobby servo `name` to a pulse in us, also a little beyond its limits."""

    name: str
    pulse_us: float


@dataclass(frozen=True, slots=True)
class EndJog:
    """The order to end jogging: all jogged joints return to their ordinary goals."""


@dataclass(frozen=True, slots=True)
class StartFace:
    """The order to drive a stopped face again. requested_by: process and user, for a log."""

    requested_by: str = ""


Order = ServoOrder | ArmJog | JogTo | JogPulse | EndJog | StartFace
