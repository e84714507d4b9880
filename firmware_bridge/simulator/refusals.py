"""Which writes a simulated servo refuses, and with which status error."""

import struct
from collections.abc import Sequence
from typing import Final

from firmware_bridge.dynamixel.control_table import Register, ServoModel, register
from firmware_bridge.dynamixel.wire.codec import StatusError
from firmware_bridge.simulator.drive import (
    CURRENT_BASED_POSITION,
    EXTENDED_POSITION,
    POSITION,
    REVERSED,
    TIMED_PROFILE,
    TORQUE_BY_GOAL,
    Drive,
)

#: Of a model's modes those whose motion is simulated. Current, velocity and PWM control are not.
SIMULATED_MODES: Final = frozenset({POSITION, EXTENDED_POSITION, CURRENT_BASED_POSITION})
_DRIVE_MODE_BITS: Final = REVERSED | TIMED_PROFILE | TORQUE_BY_GOAL
_MODE, _LIMITS = register("operating_mode").address, register("max_position_limit").address
_WATCHDOG: Final = register("bus_watchdog").address
_TRIPPED: Final = 0xFF
#: Modes 4 and 5 count turns: https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/#goal-position116
_FARTHEST: Final = 1_048_575
_LIMIT_OF: Final = {
    "goal_velocity": "velocity_limit",
    "goal_current": "current_limit",
    "goal_pwm": "pwm_limit",
}


class Refusals:
    """Asked before every write; answers with a `StatusError`, or 0 to let it pass."""

    def __init__(self, model: ServoModel, drive: Drive) -> None:
        self._drive = drive
        self._table = drive.table
        self._memory = drive.table.bytes
        self._modes = SIMULATED_MODES & set(model.modes)

    def of_all(self, pieces: Sequence[tuple[Register, int]]) -> int:
        """The first reason against a write of these registers, with these values."""
        for entry, value in pieces:
            error = self._of_one(entry, value)
            if error:
                return error
        values = {entry.name: value for entry, value in pieces}
        if "min_position_limit" in values or "max_position_limit" in values:
            low = values.get("min_position_limit", self._table["min_position_limit"])
            high = values.get("max_position_limit", self._table["max_position_limit"])
            if low > high:
                return StatusError.DATA_LIMIT
        return 0

    def of_goal_position(self, goal: int) -> int:
        """Whether this goal is outside the range, or the watchdog has tripped."""
        if self._memory[_WATCHDOG] == _TRIPPED:
            return StatusError.DATA_RANGE
        low, high = -_FARTHEST, _FARTHEST
        if self._memory[_MODE] == POSITION:
            high, low = struct.unpack_from("<II", self._memory, _LIMITS)
        return 0 if low <= goal <= high else StatusError.DATA_LIMIT

    def _of_one(self, entry: Register, value: int) -> int:
        name, table = entry.name, self._table
        if entry.in_eeprom and self._drive.torque_on:
            return StatusError.ACCESS
        if entry.low is not None and not entry.low <= value <= (entry.high or 0):
            return StatusError.DATA_RANGE
        if name == "goal_position":
            return self.of_goal_position(value)
        wrong = False
        if name == "operating_mode":
            wrong = value not in self._modes
        elif name == "drive_mode":
            wrong = bool(value & ~_DRIVE_MODE_BITS)
        elif name == "bus_watchdog":
            wrong = value != 0 and self._memory[_WATCHDOG] == _TRIPPED
        elif name in _LIMIT_OF:
            wrong = self._memory[_WATCHDOG] == _TRIPPED
            if not wrong and abs(value) > table[_LIMIT_OF[name]]:
                return StatusError.DATA_LIMIT
        elif name == "torque_enable" and value and self._drive.broken:
            return StatusError.ACCESS
        return StatusError.DATA_RANGE if wrong else 0
