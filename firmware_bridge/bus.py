"""The interface of every servo bus, and its readings: position, errors, temperature, torque.

Trouble of a single servo (a refused goal, a lost answer) is data in `Readings`, not an exception:
nine servos go on when the tenth fails. Exceptions, for trouble of all servos: module `errors`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from typing import Final, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.capabilities import BusCapabilities
from firmware_bridge.known_torque import KnownTorque

#: float64 of any shape; docstrings say which.
Array = NDArray[np.float64]


def any_set(values: NDArray[np.bool_] | NDArray[np.number]) -> bool:
    """Return whether any value is not 0; ten times as quick as `any()` for a face's few joints.

    The bytes are tested, so that -0.0 counts as not 0.

    Parameters
    ----------
    values : NDArray[np.bool_] | NDArray[np.number]
        (n,).

    Returns
    -------
    bool
        True if at least one byte is not 0.
    """
    return bool(values.tobytes().strip(b"\0"))


def check_shape(positions_deg: Array, shape: tuple[int, ...]) -> None:
    """Raise ValueError where positions do not have the shape (n_servos,) of a bus's goals."""
    if positions_deg.shape != shape:
        raise ValueError(f"expected positions of shape {shape}, got {positions_deg.shape}")


def all_set(flags: NDArray[np.bool_]) -> bool:
    """Return whether all flags are true; their bytes are tested, which is quicker than `all()`.

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


#: A servo of unknown position moves no faster than this until it has caught up with its goal.
CATCH_UP_DEG_S: Final = 60.0
#: The number in `errors` of a servo that was given a goal outside its range: Dynamixel's, used for
#: servos of every kind.
GOAL_OUT_OF_RANGE: Final = 6


class HardwareError(IntFlag):
    """Bits of a Dynamixel servo's register `hardware_error_status`.

    https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/#hardware-error-status70
    """

    INPUT_VOLTAGE = 0x01
    OVERHEATING = 0x04
    ENCODER = 0x08
    ELECTRICAL_SHOCK = 0x10
    OVERLOAD = 0x20


def describe_errors(bits: int) -> str:
    """Return the `HardwareError` bits set in `bits` as words, as in `overheating and overload`.

    `none` for 0; `unknown` with the number where no bit is known.
    """
    words = [e.name.lower().replace("_", " ") for e in HardwareError if e & bits and e.name]
    return " and ".join(words) or ("none" if not bits else f"unknown ({bits:#04x})")


@dataclass(frozen=True, slots=True)
class Feedback:
    """Positions, load and errors of all servos, read in every tick. Arrays are (n_servos,).

    time_s: monotonic seconds of the read. positions_deg: NaN for a servo that never answered, or
    cannot report its position. effort: share of the stall torque, 0..1; NaN where it is not
    measured. errors: number of the servo's last error, 0 = none; `GOAL_OUT_OF_RANGE` where its last
    goal was skipped. age_s: age of each servo's values; 0 = answered just now, or cannot answer.
    ready: False for servos that start without a known position, one after another, until their turn
    has come; sent_deg: the angle sent last to each, short of its goal while the servo catches up.
    Both are None where every servo has started and was sent its goal.
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
    """The last readings of all servos' condition, polled one at a time; arrays are (n_servos,).

    silent_s: seconds since a servo's last answer. torque: numbers of `Torque`, as the bus knows
    them (`ServoBus.torque`). watchdog_tripped: the servo stopped by itself because it received no
    packet in time. hardware_errors: bits of `HardwareError`. temperature_degc, voltage_v: NaN =
    never read, or not measured. room_degc: how far the servo's temperature is below its own limit;
    45 before the first reading, infinite where it is not measured. effort: share of the stall
    torque; current_ma: NaN where it is not measured. n_unanswered: requests of ticks left
    unanswered so far.
    """

    silent_s: Array
    torque: NDArray[np.int8]
    watchdog_tripped: NDArray[np.bool_]
    hardware_errors: NDArray[np.uint8]
    temperature_degc: Array
    room_degc: Array
    voltage_v: Array
    effort: Array
    current_ma: Array
    n_unanswered: NDArray[np.int64]


class ServoState(IntEnum):
    """The state of one servo in `ServoSupervision`: driven, or why it gets no goals."""

    DRIVEN = 0
    WAITING = 1
    COOLING = 2
    REBOOTING = 3
    FAILED = 4
    SWITCHING_OFF = 5
    OFF = 6


#: Of `ServoState`, by its number.
STATE_WORDS = tuple(state.name.lower().replace("_", " ") for state in ServoState)


@dataclass(frozen=True, slots=True)
class ServoHealth:
    """The condition of one servo for logs, tables and web pages. NaN: never read, or not measured.

    state: `ServoState` in words. load: share of the stall torque, 0..1. current_ma: None: never
    read, or not measured by this servo model. hardware_errors: bits of `HardwareError`. n_reboots,
    n_unanswered: restarts, and requests left unanswered, since the bridge was made. torque_on:
    None where it is unknown (`firmware_bridge.known_torque`).
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
    torque_on: bool | None


@dataclass(frozen=True, slots=True)
class Readings:
    """The newest reply of each servo. Every array is (n_servos,), in the face YAML's order.

    positions_deg: angle of each joint; NaN for a servo that never answered or cannot report it.
    goals_deg: each servo's goal position, with torque off the goal it would go to; NaN: not read.
    torque: numbers of `Torque`, as the bus knows them after this read.
    errors: number in the last status packet, 0 = none;
        https://emanual.robotis.com/docs/en/dxl/protocol2/#error
    age_s: age of each servo's values; 0 = read just now, infinity = never.
    """

    time_s: float
    positions_deg: Array
    goals_deg: Array
    torque: NDArray[np.int8]
    errors: NDArray[np.uint8]
    age_s: Array

    @property
    def missing(self) -> NDArray[np.bool_]:
        """Mask of the servos that did not answer this read.

        Returns
        -------
        NDArray[np.bool_]
            (n_servos,): True where `age_s` is above 0.
        """
        return self.age_s > 0.0

    def start_deg(self, can: BusCapabilities) -> Array:
        """Return the joint angles from which a motion may start.

        Parameters
        ----------
        can : BusCapabilities
            Which servos report their position.

        Returns
        -------
        Array
            (n_joints,) degrees: positions of servos that report them, last goals of all others; 0
            for a servo that never answered or had no goal yet.
        """
        has_place = [can.of(index).place for index in range(len(self.goals_deg))]
        return np.nan_to_num(np.where(has_place, self.positions_deg, self.goals_deg))


class ServoBus(Protocol):
    """The servos of one face as one bus, in joint degrees.

    A context manager: its port is open from `__enter__` to `__exit__`, which first switches torque
    off on every servo on which it was switched on. Every method raises PortError when the port
    fails. Only `TorqueGate` calls `enable_torque`.
    """

    @property
    def capabilities(self) -> BusCapabilities:
        """The capabilities of the servos; known before the port is open, and never changed."""

    @property
    def torque(self) -> KnownTorque:
        """What is known of every servo's torque, by evidence; reading it sends nothing."""

    def write_positions(self, positions_deg: Array) -> None:
        """Send every servo its next goal position; return before the servos have arrived.

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
        """Accept goals of `joints` beyond their limits from now on, up to `JointPulse.reach_us`.

        For the search for the limits of hobby servos; a bus without them does nothing. Goals of all
        other joints stay within their limits.

        Parameters
        ----------
        joints : NDArray[np.bool_]
            (n_servos,): True for joints that may go beyond their limits.
        """

    def read(self) -> Readings:
        """Read and return position, goal position and torque of every servo."""

    def feedback(self) -> Feedback:
        """Read and return position, load and errors of every servo, as every tick does."""

    def remarks(self) -> Sequence[str]:
        """Return what is unusual about adapter and servos, as sentences; the list only grows."""

    def look_after(self) -> Health:
        """Read the condition of the next servo in turn; return the last readings of all servos.

        Condition: torque, errors, temperature and the like, as in `Health`. To be called once in
        every tick.
        """

    def obstacle(self, index: int) -> str:
        """Return why servo `index` cannot hold its position as the YAML requires; empty: it can.

        Reads its model, settings and position; changes nothing.
        """

    def forgive(self, index: int) -> None:
        """Forget what was wrong with servo `index`, since a person has it tried again."""

    def enable_torque(self, index: int) -> str:
        """Switch one servo's torque on; return why it stays off, or "" if the servo confirmed.

        Its goal becomes its present position first, so that nothing moves; speed and strength start
        low; the bus watchdog runs. A servo with an obstacle gets no torque.
        """

    def keep_torque(self, index: int) -> bool:
        """Hold a servo whose torque is on at its present position; return whether it confirmed.

        Switches no torque on: a limp servo stays limp (False). Used after a lost connection, for a
        face that a person has frozen in its pose.
        """

    def disable_torque(self, index: int) -> bool:
        """Switch one servo's torque off; return whether the servo confirmed it.

        True, too, for a servo that was sent the packet and cannot confirm.
        """

    def disable_all(self) -> NDArray[np.bool_]:
        """Switch the torque of every servo off now.

        Returns
        -------
        NDArray[np.bool_]
            (n_servos,): True where a servo confirmed, or was sent the packet and cannot confirm.
        """

    def reboot(self, index: int) -> None:
        """Restart one servo, which clears its hardware error and leaves its torque off."""

    def reopen(self) -> None:
        """Open the port again after it has failed; send nothing to the servos."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *exc: object) -> None: ...
