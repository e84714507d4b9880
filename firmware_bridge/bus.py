"""What every servo bus answers to, and what it reports: places, errors, heat, voltage, torque.

What a single servo reports in passing (a refused goal, a lost answer) is data in `Readings`, not an
exception: nine servos go on when the tenth has trouble. What can go wrong with all: `errors`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import Final, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.capabilities import BusCapabilities

#: float64 of any shape; docstrings say which.
Array = NDArray[np.float64]


def any_set(values: NDArray[np.bool_] | NDArray[np.number]) -> bool:
    """Return whether any value is not 0; ten times as quick as `any()` for a face's few joints.

    By their bytes: -0.0, which nothing here counts from, is taken for something else than 0.

    Parameters
    ----------
    values : NDArray[np.bool_] | NDArray[np.number]
        (n,).

    Returns
    -------
    bool
        True where at least one byte is set.
    """
    return bool(values.tobytes().strip(b"\0"))


def all_set(flags: NDArray[np.bool_]) -> bool:
    """Return whether all flags are true, by their bytes as in `any_set`.

    Parameters
    ----------
    flags : NDArray[np.bool_]
        (n,).

    Returns
    -------
    bool
        True for an empty array, too.
    """
    return 0 not in flags.tobytes()


#: A servo of which nobody knows where it stands is no faster until it has caught up with its goal.
CATCH_UP_DEG_S: Final = 60.0
#: In `errors` of a servo that was given a goal outside its range; of Dynamixel's, and for all.
GOAL_OUT_OF_RANGE: Final = 6


class HardwareError(IntFlag):
    """https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/#hardware-error-status70 ."""

    INPUT_VOLTAGE = 0x01
    OVERHEATING = 0x04
    ENCODER = 0x08
    ELECTRICAL_SHOCK = 0x10
    OVERLOAD = 0x20


def describe_errors(bits: int) -> str:
    """Return hardware errors in words, such as `overload and overheating`; `none` for 0."""
    words = [e.name.lower().replace("_", " ") for e in HardwareError if e & bits and e.name]
    return " and ".join(words) or ("none" if not bits else f"unknown ({bits:#04x})")


@dataclass(frozen=True, slots=True)
class Feedback:
    """Where the servos stand, every tick. Arrays are (n_servos,).

    positions_deg: NaN for a servo that never answered, or cannot say. effort: share of the stall
    torque, 0..1; NaN where it is not measured. age_s: 0 = answered just now, or cannot say.
    ready: of servos that start without a place, those that go to their goals by now, and sent_deg:
    where each was sent last, short of its goal while it catches up; None: all are, at their goals.
    """

    time_s: float
    positions_deg: Array
    effort: Array
    errors: NDArray[np.uint8]
    age_s: Array
    ready: NDArray[np.bool_] | None = None
    sent_deg: Array | None = None


@dataclass(frozen=True, slots=True)
class Health:
    """The last reading of each servo's condition; one servo is polled at a time.

    silent_s: how long nothing has come from it. torque_on: as its register says.
    watchdog_tripped: it stopped by itself since it heard nothing.
    temperature_degc, voltage_v: NaN = never heard, or not measured; room_degc: how far it is below
    its own limit, infinite where that is unknown.
    effort: share of the stall torque; current_ma: NaN where it is not measured.
    n_unanswered: questions of the tick that it did not answer so far.
    """

    silent_s: Array
    torque_on: NDArray[np.bool_]
    watchdog_tripped: NDArray[np.bool_]
    hardware_errors: NDArray[np.uint8]
    temperature_degc: Array
    room_degc: Array
    voltage_v: Array
    effort: Array
    current_ma: Array
    n_unanswered: NDArray[np.int64]


class ServoState(IntEnum):
    """What a servo is doing, as `ServoSupervision` sees it."""

    DRIVEN = 0
    WAITING = 1
    COOLING = 2
    REBOOTING = 3
    FAILED = 4
    SWITCHING_OFF = 5
    OFF = 6

    @property
    def word(self) -> str:
        """The state as a word, for people and programs."""
        return STATE_WORDS[self]


#: Of `ServoState`, by its number.
STATE_WORDS = tuple(state.name.lower().replace("_", " ") for state in ServoState)


@dataclass(frozen=True, slots=True)
class ServoHealth:
    """How one servo is, for people: a log, a table, a page. NaN: never heard, or not measured.

    state: `ServoState` in words. load: share of the stall torque, 0..1. current_ma: None where the
    model does not measure it. hardware_errors: bits of `HardwareError`. n_reboots, n_unanswered:
    since the bridge was made.
    """

    name: str
    servo_id: int
    state: str
    temperature_degc: float
    load: float
    voltage_v: float
    current_ma: float | None
    hardware_errors: int
    n_reboots: int
    n_unanswered: int
    torque_on: bool


@dataclass(frozen=True, slots=True)
class Readings:
    """The newest reply of each servo. Every array is (n_servos,), in the face YAML's order.

    positions_deg: where each joint stands; NaN for a servo that has never answered, or cannot.
    goals_deg: where each servo is trying to be, or would with torque on; NaN when it did not say.
    torque_on: whether the servo holds its goal by force.
    errors: number in the last status packet, 0 = none;
        https://emanual.robotis.com/docs/en/dxl/protocol2/#error
    age_s: how old each servo's part is; 0 = read just now, infinity = never.
    """

    time_s: float
    positions_deg: Array
    goals_deg: Array
    torque_on: NDArray[np.bool_]
    errors: NDArray[np.uint8]
    age_s: Array

    @property
    def missing(self) -> NDArray[np.bool_]:
        """Which servos did not answer this time.

        Returns
        -------
        NDArray[np.bool_]
            (n_servos,).
        """
        return self.age_s > 0.0

    def start_deg(self, can: BusCapabilities) -> Array:
        """Return the places from which the joints may be moved.

        Parameters
        ----------
        can : BusCapabilities
            Which servos report their place.

        Returns
        -------
        Array
            (n_joints,) degrees: places, 0 for a servo never heard; of servos without a place their
            last goals, 0 before the first.
        """
        has_place = [can.of(index).place for index in range(len(self.goals_deg))]
        return np.nan_to_num(np.where(has_place, self.positions_deg, self.goals_deg))


class ServoBus(Protocol):
    """All servos of one face, spoken to as one, in joint degrees.

    Use it as a context manager: it holds its port from `__enter__` to `__exit__`, and leaving
    first switches torque off on every servo that it was switched on for. Every method raises
    PortError when the port fails. Only `TorqueGate` calls `enable_torque`.
    """

    @property
    def capabilities(self) -> BusCapabilities:
        """What its servos can do; known before the port is open, and never another."""

    def write_positions(self, positions_deg: Array) -> None:
        """Give every servo its next goal; return before it arrives.

        A servo keeps its old goal when the new one lies outside its own range, or is NaN.

        Parameters
        ----------
        positions_deg : Array
            (n_servos,) joint degrees.

        Raises
        ------
        ValueError
            positions_deg has another shape.
        """

    def widen(self, joints: NDArray[np.bool_]) -> None:
        """Take goals of these servos as far as a person may find limits (`Joint.pulse`).

        Of all others within their limits. A bus without pulses takes no notice.

        Parameters
        ----------
        joints : NDArray[np.bool_]
            (n_servos,).
        """

    def read(self) -> Readings:
        """Ask every servo where it stands, where it is going, and whether it holds."""

    def feedback(self) -> Feedback:
        """Ask every servo where it stands: the short question of every tick."""

    def remarks(self) -> Sequence[str]:
        """What is unusual about adapter and servos, in sentences for a log; they become more."""

    def look_after(self) -> Health:
        """Ask one servo, the next in turn, how it is; what is known of all."""

    def obstacle(self, index: int) -> str:
        """Why one servo cannot hold its place as the face's YAML says; empty: it can.

        Asks who it is, how it is set up, and where it stands; changes nothing.
        """

    def enable_torque(self, index: int) -> str:
        """Let one servo hold the place where it stands; why it does not, empty: it confirmed.

        The goal becomes the place first, so that nothing moves; speed and strength start low; the
        bus watchdog runs. A servo with an obstacle gets no torque.
        """

    def keep_torque(self, index: int) -> bool:
        """Let a servo that holds go on holding where it stands; whether it holds.

        Switches no torque on: after a lost connection, for a face frozen by a person.
        """

    def disable_torque(self, index: int) -> bool:
        """Switch one servo's torque off; True.

        It confirmed, or was sent the order and cannot confirm.
        """

    def disable_all(self) -> NDArray[np.bool_]:
        """Switch the torque of every servo off now.

        Returns
        -------
        NDArray[np.bool_]
            (n_servos,): True where a servo confirmed, or was sent the order and cannot confirm.
        """

    def reboot(self, index: int) -> None:
        """Restart one servo: clears its hardware error; it comes back limp."""

    def reopen(self) -> None:
        """Open the port again after it has failed. Asks no servo anything."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *exc: object) -> None: ...
