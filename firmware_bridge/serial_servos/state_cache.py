"""The latest reports of the servos of one chain, servo by servo."""

from collections.abc import Mapping, Sequence
from typing import Final, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.bus import Array, Health
from firmware_bridge.known_torque import SILENT_S, KnownTorque

_Kind = TypeVar("_Kind", bound=np.generic)


class ServoIdentity(Protocol):
    """What a servo reported about itself: its EEPROM registers and its return delay."""

    @property
    def eeprom(self) -> Mapping[str, int]:
        """EEPROM register values by name, with `min_position_limit` and `max_position_limit`."""

    @property
    def return_delay_s(self) -> float:
        """How many seconds the servo waits before it answers."""


#: Until a servo has been asked: as if freshly switched on in a warm room, 25 degC under 70.
ROOM_DEGC: Final = 45.0


class ServoStateCache:
    """The last report of every servo. Every array is (n_servos,), in the face's order.

    pulses, goals: position registers, NaN = never received; effort: share of the stall torque; low,
    high: the servo's own limits in pulses; hottest: its temperature limit, degC; room_degc: how far
    its temperature is below that; heard_s: when the servo answered last; enabled: this bus tried to
    switch torque on, or kept it on, and has not confirmed its own torque off since; tripped: the
    bus watchdog stopped the servo; hardware: bits of its hardware error; torque: what is known of
    it. `health` and the bus's feedback return these arrays without a copy, in every tick: so arrays
    are replaced, by `set_one` for one servo, and never written into.
    """

    def __init__(
        self,
        ids: Sequence[int],
        highest_pulse: float,
        hottest_degc: Sequence[float],
        return_delay_s: float,
    ) -> None:
        """Start without reports; the arguments are used until each servo's EEPROM has been read.

        highest_pulse: upper position limit, that of all servos. hottest_degc: temperature limit of
        each servo. return_delay_s: seconds that servos wait before they answer.
        """
        n = len(ids)
        self.ids = tuple(ids)
        self.index = {servo_id: k for k, servo_id in enumerate(ids)}
        self.low = np.zeros(n)
        self.high = np.full(n, highest_pulse)
        self.return_delay_s = np.full(n, return_delay_s)
        self.hottest = np.array(hottest_degc)
        self.pulses: Array = np.full(n, np.nan)
        self.goals: Array = np.full(n, np.nan)
        self.effort: Array = np.zeros(n)
        self.no_errors = read_only(np.zeros(n, dtype=np.uint8))
        self.no_age_s = read_only(np.zeros(n))
        self.errors = self.no_errors
        self.heard_s = np.full(n, -np.inf)
        self.torque = KnownTorque(n)
        self.enabled = np.zeros(n, dtype=np.bool_)
        self.tripped = read_only(np.zeros(n, dtype=np.bool_))
        self.hardware = self.no_errors
        self.temperature_degc: Array = read_only(np.full(n, np.nan))
        self.room_degc: Array = read_only(np.full(n, ROOM_DEGC))
        self.voltage_v: Array = read_only(np.full(n, np.nan))
        self.unanswered = read_only(np.zeros(n, dtype=np.int64))

    def set_one(self, name: str, index: int, value: float) -> None:
        """Set one servo's value in the array `name`: replace the array if the value has changed."""
        array = getattr(self, name)
        if array.item(index) != value:
            array = array.copy()
            array[index] = value
            setattr(self, name, read_only(array))

    def set_goals(
        self, pulses: Array, taken: NDArray[np.bool_] | None = None, error: int = 0
    ) -> None:
        """Store the goals that are sent now; a servo that is sent none keeps its last goal.

        Parameters
        ----------
        pulses : Array
            (n_servos,) goals as values of the position register.
        taken : NDArray[np.bool_] | None
            (n_servos,): True where the goal is sent; None: all are.
        error : int
            Error number to report for the servos that are sent no goal.
        """
        if taken is None:
            self.errors, self.goals = self.no_errors, pulses
            return
        self.errors = np.where(taken, 0, error).astype(np.uint8)
        self.goals = np.where(taken, pulses, self.goals)

    def take_identity(
        self, index: int, found: ServoIdentity, hottest_degc: float, now_s: float
    ) -> None:
        """Store the limits and return delay in `found`, which servo `index` reported at `now_s`.

        hottest_degc: its temperature limit.
        """
        self.low[index] = found.eeprom["min_position_limit"]
        self.high[index] = found.eeprom["max_position_limit"]
        self.hottest[index] = hottest_degc
        self.return_delay_s[index] = found.return_delay_s
        self.heard_s[index] = now_s

    def ages(self, answered: Sequence[int], now_s: float) -> Array:
        """Return how long ago each servo answered last, after a read that some did not answer.

        From half a second of silence on, a servo's torque is marked as unknown.

        Parameters
        ----------
        answered : Sequence[int]
            Ids that just answered.
        now_s : float
            Monotonic seconds.

        Returns
        -------
        Array
            (n_servos,) seconds; 0 for the ids in `answered`.
        """
        ages = np.maximum(now_s - self.heard_s, 1e-9)  # above 0: it did not answer this read
        ages[[self.index[each] for each in answered]] = 0.0
        self.torque.forget(np.flatnonzero(ages >= SILENT_S).tolist())
        return ages

    def count_silent(self, ages_s: Array) -> None:
        """Add 1 to the count of unanswered requests of every servo whose age is above 0.

        Parameters
        ----------
        ages_s : Array
            (n_servos,) seconds; 0: answered.
        """
        self.unanswered = read_only(self.unanswered + (ages_s > 0.0))

    def health(self, now_s: float, current_ma: Array) -> Health:
        """Return the condition of all servos, in arrays that do not change afterwards.

        Parameters
        ----------
        now_s : float
            Monotonic seconds.
        current_ma : Array
            (n_servos,) mA.

        Returns
        -------
        Health
            The arrays are (n_servos,).
        """
        return Health(
            silent_s=now_s - self.heard_s,
            torque=self.torque.states,
            watchdog_tripped=self.tripped,
            hardware_errors=self.hardware,
            temperature_degc=self.temperature_degc,
            room_degc=self.room_degc,
            voltage_v=self.voltage_v,
            effort=self.effort,
            current_ma=current_ma,
            n_unanswered=self.unanswered,
        )


def read_only(array: NDArray[_Kind]) -> NDArray[_Kind]:
    """Return `array` itself, made read-only in place.

    Parameters
    ----------
    array : NDArray[_Kind]
        Of any shape.

    Returns
    -------
    NDArray[_Kind]
        `array` itself.
    """
    array.flags.writeable = False
    return array
