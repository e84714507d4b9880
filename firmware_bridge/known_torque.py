"""What is known of the torque of a bus's servos, by evidence: the one truth of it.

A servo's torque is ON or OFF because the servo confirmed it, or because pulses were really sent to
it or its controller confirmed that it sends none. It is UNKNOWN before that, from any packet on that
may change it until the servo has confirmed, once the servo has been silent for half a second, and
when the port is lost. A bus writes it; every status, sentence, count and exit status reads it.
"""

from collections.abc import Iterable
from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray


class Torque(IntEnum):
    """What is known of one servo's torque. ON: it holds its goal by force, or gets pulses."""

    OFF = 0
    ON = 1
    UNKNOWN = 2


_OFF, _ON, _UNKNOWN = (int(each) for each in Torque)
#: As JSON says it: None where it is unknown.
AS_JSON: Final = (False, True, None)


class KnownTorque:
    """Torque of n servos: on, off or unknown, and when the evidence of it came.

    states: (n,) int8, numbers of `Torque`; replaced at a change and never written into, so that it
    may be handed out without a copy. at_s: (n,) monotonic seconds of the newest evidence; -infinity
    before any.
    """

    def __init__(self, n_servos: int) -> None:
        """Know nothing yet."""
        self.states: NDArray[np.int8] = np.full(n_servos, _UNKNOWN, dtype=np.int8)
        self.at_s = np.full(n_servos, -np.inf)

    def note(self, index: int, at_s: float, *, on: bool) -> None:
        """Take evidence of one servo: it confirmed at monotonic `at_s` that its torque is `on`."""
        self.at_s[index] = at_s
        self._set(index, _ON if on else _OFF)

    def forget(self, indices: Iterable[int] | None = None) -> None:
        """Know nothing of these servos from now on; None: of all.

        To be called before a packet that may change torque, when a servo is silent, and when the
        port is lost.
        """
        if indices is None:
            self.states = np.full_like(self.states, _UNKNOWN)
            return
        for index in indices:
            self._set(index, _UNKNOWN)

    def off_since(self, since_s: float) -> NDArray[np.bool_]:
        """Return which servos are known to be off by evidence that came at `since_s` or later.

        Parameters
        ----------
        since_s : float
            Monotonic seconds.

        Returns
        -------
        NDArray[np.bool_]
            (n,).
        """
        return (self.states == _OFF) & (self.at_s >= since_s)

    @property
    def any_on(self) -> bool | None:
        """Whether any servo is on. False: every servo is off. None: none is known to be on, but
        not every servo is known to be off.
        """
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

    def _set(self, index: int, state: int) -> None:
        if self.states.item(index) != state:
            states = self.states.copy()
            states[index] = state
            self.states = states
