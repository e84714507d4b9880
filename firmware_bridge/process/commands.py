"""Stops, settings and orders to a running face: as words of the control socket, and as a queue.

Every sender of commands writes into the `CommandQueue`, and the loop of the face takes from it. It
never grows: one entry for each level of stop and one for each setting, so a stop is never lost and
of several values of a setting the newest counts; orders keep their sequence, up to a maximum.
Nothing here locks, since a second signal may break into the loop anywhere; each step is one
operation on a dictionary or a queue, which CPython does not interrupt.

set NAME VALUE [NAME VALUE ...]     servo NAME off|on|reboot     start
jog arm | NAME DEG | NAME PULSE us | end
"""

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Final

from firmware_bridge.stopping import (
    ArmJog,
    EndJog,
    JogPulse,
    JogTo,
    Order,
    ServoOrder,
    ServoSwitch,
    StartFace,
    StopLevel,
    StopRequest,
)

#: A stop that goes further replaces the others: freezing gives way to an end, an end to limp.
_FURTHEST_FIRST: Final = (StopLevel.LIMP, StopLevel.SOFT, StopLevel.FREEZE)
#: Orders that wait for the next tick; more than as many clients as may be connected can send.
_MOST_ORDERS: Final = 64


class CommandError(ValueError):
    """A refused command; the text states in one line what was refused and what is allowed."""


@dataclass(frozen=True, slots=True)
class Setting:
    """A number that may change while a face runs: its value, and the lowest and highest allowed."""

    value: float
    low: float
    high: float


class CommandQueue:
    """The stops, changed settings and orders for a face: any thread writes, one loop takes them."""

    def __init__(
        self,
        settings: Mapping[str, Setting] | None = None,
        *,
        on_change: Callable[[Mapping[str, float]], None] | None = None,
    ) -> None:
        """Make an empty queue; settings: those that may be changed, by name.

        on_change: called with names and values at every change; must return at once.
        """
        self._settings = dict(settings or {})
        self._on_change = on_change
        self._stops: dict[StopLevel, StopRequest] = {}
        self._changes: dict[str, float] = {}
        self._orders: deque[Order] = deque()
        self._refusal: Callable[[Order], str] = _no_driver

    @property
    def values(self) -> dict[str, float]:
        """The last value of every setting."""
        return {name: setting.value for name, setting in self._settings.items()}

    def stop(self, level: StopLevel, requested_by: str = "", *, ends: bool = False) -> None:
        """Queue a stop in place of an earlier one of its level.

        requested_by: process and user, for a log. ends: whether the face's process ends with the
        stop; True remains if the earlier stop had it.
        """
        before = self._stops.get(level)
        ends = ends or (before is not None and before.ends)
        self._stops[level] = StopRequest(level, requested_by, ends)

    def change(self, values: Mapping[str, float]) -> None:
        """Queue new values of settings, by name, all or none. Raises CommandError for a bad one."""
        changed = {name: self._checked(name, value) for name, value in values.items()}
        self._settings.update(changed)
        self._changes.update(values)
        if self._on_change is not None:
            self._on_change(values)

    def attend(self, refusal: Callable[[Order], str]) -> None:
        """Accept orders from now on.

        refusal: returns the reason why an order is refused, or an empty text to accept it.
        """
        self._refusal = refusal

    def order(self, order: Order) -> None:
        """Queue an order: to switch or jog a servo, or to start the face.

        Raises CommandError when the queue is full or the order is refused.
        """
        if len(self._orders) >= _MOST_ORDERS:
            raise CommandError("too many orders wait for this face; try again in a second")
        if why_not := self._refusal(order):
            raise CommandError(why_not)
        self._orders.append(order)

    def take_stop(self) -> StopRequest | None:
        """Return the furthest stop requested since the last call, and remove all; None: no stop.

        Limp goes further than soft, soft further than freeze. `ends` is True if any request has it.
        """
        requests = [self._stops.pop(level) for level in _FURTHEST_FIRST if level in self._stops]
        if not requests:
            return None
        return replace(requests[0], ends=any(each.ends for each in requests))

    def take_changes(self) -> dict[str, float]:
        """Return and remove the newest value of each setting changed since the last call."""
        return {name: self._changes.pop(name) for name in list(self._changes)}

    def take_orders(self) -> list[Order]:
        """Return and remove all orders since the last call, oldest first."""
        return [self._orders.popleft() for _ in range(len(self._orders))]

    def _checked(self, name: str, value: float) -> Setting:
        """Return the setting `name` with a new `value`; nothing is stored.

        Raises CommandError for an unknown name, or a value that is out of range or not finite.
        """
        setting = self._settings.get(name)
        if setting is None:
            raise CommandError(f"{name!r}: no such setting; {self._names()}")
        if not (math.isfinite(value) and setting.low <= value <= setting.high):
            allowed = f"{setting.low:g} to {setting.high:g}"
            raise CommandError(f"{name} is {value:g}; allowed: {allowed}")
        return Setting(value, setting.low, setting.high)

    def _names(self) -> str:
        if not self._settings:
            return "this face has no settings that change while it runs"
        named = (f"{name} ({each.low:g} to {each.high:g})" for name, each in self._settings.items())
        return f"there are: {', '.join(named)}"


def _no_driver(_order: Order) -> str:
    return "no bridge drives the servos just now; ask again"


#: The first words of the commands.
SET_WORD: Final = "set"
SERVO_WORD: Final = "servo"
JOG_WORD: Final = "jog"
ARM_WORD: Final = "arm"
END_WORD: Final = "end"
START_WORD: Final = "start"
#: Follows a number that is a pulse, not an angle.
PULSE_UNIT: Final = "us"

_WITHOUT_SERVO: Final[Mapping[str, Order]] = {ARM_WORD: ArmJog(), END_WORD: EndJog()}
_SAY_SET: Final = "say: set NAME VALUE [NAME VALUE ...]"
_SAY_SERVO: Final = "say: servo NAME off|on|reboot"
_SAY_JOG: Final = "say: jog arm, jog NAME DEG, or jog end; jog NAME PULSE us for a hobby servo"


def command_answer(
    word: str, commands: CommandQueue, requested_by: Callable[[], str]
) -> dict[str, object] | None:
    """Execute the command `word`, such as `set gain 1.2`, and return its answer; None: no command.

    commands: the queue that receives settings and orders. requested_by: returns the sender's name
    for a log. A refused command is answered by {"error"}.
    """
    first, *rest = word.split()
    try:
        if first == SET_WORD:
            return _set(rest, commands)
        if first == SERVO_WORD:
            return _switch(rest, commands, requested_by)
        if first == JOG_WORD:
            return _jog(rest, commands)
        if word == START_WORD:
            commands.order(StartFace(requested_by()))
            return {"accepted": START_WORD}
    except CommandError as error:
        return {"error": str(error)}
    return None


def _set(words: list[str], commands: CommandQueue) -> dict[str, object]:
    """Queue the changes of a `set` command, and return its answer; CommandError if refused.

    words: NAME VALUE pairs.
    """
    if not words or len(words) % 2:
        raise CommandError(_SAY_SET)
    names = words[::2]
    if len(set(names)) < len(names):
        raise CommandError("the same setting is given twice; give it once")
    values = {name: _number(text) for name, text in zip(names, words[1::2], strict=True)}
    commands.change(values)
    if len(names) == 1:
        return {"set": names[0], "value": values[names[0]]}
    return {"set": values}


def _switch(
    words: list[str], commands: CommandQueue, requested_by: Callable[[], str]
) -> dict[str, object]:
    """Queue a `servo` command, NAME off|on|reboot; return its answer. Raises CommandError."""
    if len(words) != 2 or words[1] not in set(ServoSwitch):
        raise CommandError(_SAY_SERVO)
    name, switch = words
    commands.order(ServoOrder(name, ServoSwitch(switch), requested_by()))
    return {"servo": name, "asked": switch}


def _jog(words: list[str], commands: CommandQueue) -> dict[str, object]:
    """Queue a `jog` command, and return its answer; CommandError if it is refused or malformed."""
    match words:
        case [word] if word in _WITHOUT_SERVO:
            commands.order(_WITHOUT_SERVO[word])
            return {"jog": word}
        case [name, angle]:
            position_deg = _number(angle)
            commands.order(JogTo(name, position_deg))
            return {"jog": name, "position_deg": position_deg}
        case [name, pulse, unit] if unit == PULSE_UNIT:
            pulse_us = _number(pulse)
            commands.order(JogPulse(name, pulse_us))
            return {"jog": name, "pulse_us": pulse_us}
    raise CommandError(_SAY_JOG)


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise CommandError(f"{text[:40]!r} is not a number") from None
