"""How the servos are: heat, voltage, errors, torque; what a bus notices between the goals."""

from dataclasses import dataclass
from enum import IntEnum, IntFlag

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.arrays import Array


class HardwareError(IntFlag):
    """https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/#hardware-error-status70 ."""

    INPUT_VOLTAGE = 0x01
    OVERHEATING = 0x04
    ENCODER = 0x08
    ELECTRICAL_SHOCK = 0x10
    OVERLOAD = 0x20


def describe_errors(bits: int) -> str:
    """In words, `overload and overheating` for one; `none` for 0."""
    words = [e.name.lower().replace("_", " ") for e in HardwareError if e & bits and e.name]
    return " and ".join(words) or ("none" if not bits else f"unknown ({bits:#04x})")


@dataclass(frozen=True, slots=True)
class Feedback:
    """Where the servos stand, every tick. Arrays are (n_servos,).

    positions_deg: NaN for a servo that never answered. effort: share of the stall torque, 0..1.
    age_s: 0 = answered just now.
    """

    time_s: float
    positions_deg: Array
    effort: Array
    errors: NDArray[np.uint8]
    age_s: Array


@dataclass(frozen=True, slots=True)
class Health:
    """What was last heard about each servo's condition; one servo is asked at a time.

    silent_s: how long nothing has come from it. torque_on: as its register says.
    watchdog_tripped: it stopped by itself since it heard nothing.
    temperature_degc: NaN = never heard; room_degc: how far it is below its own limit.
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
        """For people and programs."""
        return STATE_WORDS[self]


#: Of `ServoState`, by its number.
STATE_WORDS = tuple(state.name.lower().replace("_", " ") for state in ServoState)


@dataclass(frozen=True, slots=True)
class ServoHealth:
    """How one servo is, for people: a log, a table, a page. NaN: never heard.

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
