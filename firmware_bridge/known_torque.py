"""What is known of the torque of a bus's servos, by evidence: the one truth of it.

A servo's torque is ON or OFF because the servo confirmed it, or because pulses were really sent to
it or its controller confirmed that it sends none. It is UNKNOWN before that, from any packet on
that may change it until the servo has confirmed, once the servo has been silent for half a second,
and when the port is lost. A bus writes it; every status, sentence, count and exit status reads it.
"""

from collections.abc import Callable, Iterable
from enum import IntEnum
from functools import wraps
from typing import Any, Final, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.errors import PortError


class Torque(IntEnum):
    """What is known of one servo's torque. ON: it holds its goal by force, or gets pulses."""

    OFF = 0
    ON = 1
    UNKNOWN = 2


_OFF, _ON, _UNKNOWN = (int(each) for each in Torque)
#: The JSON value of each number of `Torque`: None where it is unknown.
AS_JSON: Final = (False, True, None)
#: The torque of a servo that has been silent for so long is unknown: it may have restarted.
SILENT_S: Final = 0.5


class KnownTorque:
    """Torque of n servos: on, off or unknown, and when the evidence of it came.

    states: (n,) int8, numbers of `Torque`; read-only and replaced at a change, so that it may be
    handed out without a copy, also to another thread. at_s: (n,) monotonic seconds of the newest
    evidence; -infinity before any. It is written after `states` and therefore read before it.
    sent_us: (n,) the pulse that was sent last to each hobby servo; NaN: none is known.
    """

    def __init__(self, n_servos: int, sent_us: NDArray[np.float64] | None = None) -> None:
        """Start with all unknown. sent_us: (n_servos,), of the bus; None: it sends no pulses."""
        self._nothing = np.full(n_servos, _UNKNOWN, dtype=np.int8)
        self._nothing.flags.writeable = False
        self.states: NDArray[np.int8] = self._nothing
        self.at_s = np.full(n_servos, -np.inf)
        self.sent_us = np.full(n_servos, np.nan) if sent_us is None else sent_us

    def note(self, index: int, at_s: float, *, on: bool) -> None:
        """Store that one servo confirmed, at monotonic `at_s`, that its torque is `on`."""
        self._set(index, _ON if on else _OFF)
        self.at_s[index] = at_s

    def forget(self, indices: Iterable[int] | None = None) -> None:
        """Mark these servos as unknown; None: all servos.

        To be called before a packet that may change torque, when a servo is silent, and when the
        port is lost.
        """
        if indices is None:
            self.states = self._nothing
            return
        for index in indices:
            self._set(index, _UNKNOWN)

    def take(self, indices: NDArray[np.intp], part: "KnownTorque") -> None:
        """Copy what `part` knows of its servos, which are those of `indices` here.

        Parameters
        ----------
        indices : NDArray[np.intp]
            (n of `part`,): the index here of each.
        part : KnownTorque
            May be written meanwhile by another thread.
        """
        self.at_s[indices], self.sent_us[indices] = part.at_s, part.sent_us
        self._put(indices, part.states)

    @property
    def any_on(self) -> bool | None:
        """Whether any servo is on; None: none is known to be on, but some are unknown."""
        states = self.states.tobytes()
        if _ON in states:
            return True
        return None if _UNKNOWN in states else False

    @property
    def all_on(self) -> bool:
        """Whether every servo is known to be on."""
        return bool((self.states == _ON).all())

    def as_json(self) -> list[bool | None]:
        """Return for each servo True (on), False (off) or None (unknown)."""
        return [AS_JSON[each] for each in self.states.tolist()]

    def records(self, now_s: float) -> list[dict[str, bool | float | None]]:
        """Return for each servo {on, age_s}: as of `as_json`, and the age of its newest evidence.

        age_s: None before any evidence.
        """
        ages_s = np.maximum(0.0, now_s - self.at_s).tolist()
        return [
            {"on": on, "age_s": round(age_s, 3) if age_s < np.inf else None}
            for on, age_s in zip(self.as_json(), ages_s, strict=True)
        ]

    def _set(self, index: int, state: int) -> None:
        if self.states.item(index) != state:
            self._put(index, state)

    def _put(self, at: int | NDArray[np.intp], found: int | NDArray[np.int8]) -> None:
        states = self.states.copy()
        states[at] = found
        states.flags.writeable = False
        self.states = states


class _KnowsTorque(Protocol):
    @property
    def torque(self) -> KnownTorque: ...


_Bus = TypeVar("_Bus", bound=_KnowsTorque)
#: The methods of a `ServoBus` that may find its port lost.
_AT_PORT: Final = (
    "write_positions", "read", "feedback", "look_after", "obstacle", "enable_torque",
    "keep_torque", "disable_torque", "disable_all", "reboot", "reopen",
)  # fmt: skip


def unknown_when_lost(bus: type[_Bus]) -> type[_Bus]:
    """Return the class of a bus, changed: a PortError of a method makes all torque unknown."""
    for name in _AT_PORT:
        setattr(bus, name, _guarded(getattr(bus, name)))
    return bus


def _guarded(method: Callable[..., Any]) -> Callable[..., Any]:
    """Return a bus's method, changed: where it raises PortError, all torque is unknown then."""

    @wraps(method)
    def guarded(bus: _KnowsTorque, *args: Any) -> Any:
        try:
            return method(bus, *args)
        except PortError:
            bus.torque.forget()
            raise

    return guarded
