"""What people and programs ask of a running face: stops, and settings to change.

Everybody who may command a face writes here: the control socket today, an API or an agent later.
The loop of the face takes from it. It never grows: one place for each level of stop and one for
each setting, so a stop is never lost and of several values of a setting the newest counts. Nothing
here locks, since a second signal may break into the loop anywhere; each step is one operation on a
dictionary, which CPython does not interrupt.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

from firmware_bridge.stopping import StopLevel

#: A stop that goes further replaces the others: freezing gives way to an end, an end to limp.
_FURTHEST_FIRST: Final = (StopLevel.LIMP, StopLevel.SOFT, StopLevel.FREEZE)


class CommandError(ValueError):
    """A command that is refused: one line, what and what is allowed."""


@dataclass(frozen=True, slots=True)
class Setting:
    """A number that may change while a face runs: its value, and the limits it must keep."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class StopRequest:
    """A stop that was asked for. asked_by: who, for a log."""

    level: StopLevel
    asked_by: str = ""


class CommandQueue:
    """One face's commands. Any thread may write; one loop takes."""

    def __init__(
        self,
        settings: Mapping[str, Setting] | None = None,
        *,
        why_none: str = "this face has no settings that change while it runs",
        on_change: Callable[[str, float], None] | None = None,
    ) -> None:
        """settings: what may be changed, by name. why_none: what is answered where there are none.

        on_change: called with name and value at every change; must return at once.
        """
        self._settings = dict(settings or {})
        self._why_none = why_none
        self._on_change = on_change
        self._stops: dict[StopLevel, str] = {}
        self._changes: dict[str, float] = {}

    @property
    def values(self) -> dict[str, float]:
        """What every setting was last set to."""
        return {name: setting.value for name, setting in self._settings.items()}

    def stop(self, level: StopLevel, asked_by: str = "") -> None:
        """Ask for a stop."""
        self._stops[level] = asked_by

    def change(self, name: str, value: float) -> None:
        """Ask for another value of a setting. Raises CommandError."""
        setting = self._settings.get(name)
        if setting is None:
            raise CommandError(f"{name!r}: no such setting; {self._names()}")
        if not (math.isfinite(value) and setting.low <= value <= setting.high):
            allowed = f"{setting.low:g} to {setting.high:g}"
            raise CommandError(f"{name} is {value:g}; allowed: {allowed}")
        self._settings[name] = Setting(value, setting.low, setting.high)
        self._changes[name] = value
        if self._on_change is not None:
            self._on_change(name, value)

    def take_stop(self) -> StopRequest | None:
        """The stop that goes furthest of those asked for since the last call; None: none."""
        for n, level in enumerate(_FURTHEST_FIRST):
            asked_by = self._stops.pop(level, None)
            if asked_by is not None:
                for weaker in _FURTHEST_FIRST[n + 1 :]:
                    self._stops.pop(weaker, None)
                return StopRequest(level, asked_by)
        return None

    def take_changes(self) -> dict[str, float]:
        """The newest value of each setting that was changed since the last call."""
        if not self._changes:
            return {}
        return {name: self._changes.pop(name) for name in list(self._changes)}

    def _names(self) -> str:
        if not self._settings:
            return self._why_none
        named = (f"{name} ({each.low:g} to {each.high:g})" for name, each in self._settings.items())
        return f"there are: {', '.join(named)}"
