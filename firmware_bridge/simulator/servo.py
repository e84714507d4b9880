"""One simulated servo: its control table, and what it answers to an instruction."""

import math
import struct
from collections.abc import Mapping
from typing import Final

from firmware_bridge.dynamixel.codec import ALERT_BIT, Instruction, StatusError
from firmware_bridge.dynamixel.control_table import (
    Register,
    ServoModel,
    baud_rates,
    register,
)
from firmware_bridge.simulator.memory import RegisterMemory
from firmware_bridge.simulator.motors import ACCELERATION_UNIT, VELOCITY_UNIT, Motors

#: Modes that are simulated: position, and position with limited current.
MODES: Final = (3, 5)
_WATCHDOG_UNIT_S: Final = 0.020
_MODE, _LIMITS = register("operating_mode").address, register("max_position_limit").address
_WATCHDOG, _GOAL = register("bus_watchdog").address, register("goal_position").address
#: realtime_tick .. present_temperature
_PRESENT: Final = struct.Struct("<HBBhhiiiiHB")
_WATCHDOG_TRIPPED: Final = -1
#: Not in the manual: how long a restart takes, and that a reset takes as long.
BOOT_S: Final = 0.5

Answer = tuple[int, bytes]


class SimulatedServo:
    """State machine over the model's control table. Its motor is number `index` of `motors`.

    Simulated: ping, read, write, reboot, factory reset, indirect data, status return level, EEPROM
    lock and persistence, status errors 1, 2, 4, 5, 6, 7 and the alert bit, hardware errors that
    latch until reboot, bus watchdog, modes 3 and 5.
    Refused with the instruction error, so not simulated: reg write, action, clear, backup, bulk
    read and write. Other modes are refused with the range error.
    """

    def __init__(self, model: ServoModel, servo_id: int, index: int, motors: Motors) -> None:
        self.model = model
        self.index = index
        self._motors = motors
        self._registers = model.registers
        self._table = RegisterMemory(model)
        self._memory = self._table.bytes
        self.hardware_error = 0
        self.deaf_until_s = 0.0
        self.booted_s = 0.0
        self.heard_s = 0.0
        self.patience_s = math.inf  # silence after which the watchdog trips; infinity while off
        self._factory_settings()
        self["id"] = servo_id
        self._restart(0.0)

    def __getitem__(self, name: str) -> int:
        return self._table[name]

    def __setitem__(self, name: str, value: int) -> None:
        self._table[name] = value

    @property
    def servo_id(self) -> int:
        """The id it answers to."""
        return self._memory[7]

    @property
    def baud_rate(self) -> int:
        """The rate it listens at."""
        return baud_rates()[self._memory[8]]

    @property
    def return_delay_s(self) -> float:
        """How long it waits before it answers."""
        return self._memory[9] * 2e-6

    @property
    def torque_on(self) -> bool:
        """Whether it holds its place."""
        return self._memory[64] == 1

    @property
    def answers_reads(self) -> bool:
        """Whether its status return level lets it."""
        return self._memory[68] >= 1

    def trip_watchdog(self) -> None:
        """Stop where it is; goals are refused until 0 is written. Torque stays on."""
        self["bus_watchdog"] = _WATCHDOG_TRIPPED
        self._set_patience()
        self._motors.stop(self.index)

    def latch(self, bits: int) -> None:
        """Note hardware errors; those in `shutdown` switch torque off."""
        if bits & ~self.hardware_error:
            self.hardware_error |= bits
            self["hardware_error_status"] = self.hardware_error
            if bits & self["shutdown"]:
                self._set_torque(on=False)

    def reboot(self, now_s: float) -> None:
        """Restart: RAM and errors are forgotten, EEPROM is kept, deaf for a while."""
        self._restart(now_s)
        self.deaf_until_s = now_s + BOOT_S

    def answer(self, instruction: int, parameters: bytes, now_s: float) -> Answer | None:
        """Do what one instruction packet asks; None: no status packet."""
        if instruction == Instruction.PING:
            return self._error(), struct.pack("<HB", self["model_number"], self["firmware_version"])
        if instruction == Instruction.READ:
            reply = self._read(parameters)
            return reply if self["status_return_level"] >= 1 else None
        level = self["status_return_level"]
        if instruction == Instruction.WRITE:
            error = self.write(parameters)
        elif instruction == Instruction.REBOOT:
            self.reboot(now_s)
            error = 0
        elif instruction == Instruction.FACTORY_RESET:
            error = self._reset(parameters, now_s)
        else:
            error = StatusError.INSTRUCTION
        return (self._error(error), b"") if level == 2 else None

    def read_span(self, address: int, size: int) -> Answer:
        """The bytes that a read, alone or among others, is answered with."""
        if size < 1 or address + size > len(self._memory):
            return self._error(StatusError.ACCESS), b""
        if address + size > 120:
            self._refresh()
        data = self._table.shown(address, size)
        return self._error(), data

    def write(self, parameters: bytes) -> int:
        """All of it or nothing; the status error."""
        if len(parameters) < 3:
            return StatusError.DATA_LENGTH
        address, data = parameters[0] | parameters[1] << 8, parameters[2:]
        if address == _GOAL and len(data) == 4:  # what nearly every write is
            goal = int.from_bytes(data, "little", signed=True)
            error = self._goal_refusal("goal_position", goal)
            if not error:
                self._memory[_GOAL : _GOAL + 4] = data
                self._take_effect("goal_position", goal)
            return error
        pieces = self._table.pieces(address, data, locked=self.torque_on)
        if isinstance(pieces, StatusError):
            return pieces
        for entry, value in pieces:
            error = self._refusal(entry, value)
            if error:
                return error
        for entry, value in pieces:
            self[entry.name] = value
            self._take_effect(entry.name, value)
        return 0

    def _error(self, error: int = 0) -> int:
        return error | (ALERT_BIT if self.hardware_error else 0)

    def _read(self, parameters: bytes) -> Answer:
        if len(parameters) != 4:
            return self._error(StatusError.DATA_LENGTH), b""
        return self.read_span(*struct.unpack("<HH", parameters))

    def _refusal(self, register: Register, value: int) -> int:
        name = register.name
        if register.in_eeprom and self.torque_on:
            return StatusError.ACCESS
        if register.low is not None and not register.low <= value <= (register.high or 0):
            return StatusError.DATA_RANGE
        if name == "operating_mode" and value not in MODES:
            return StatusError.DATA_RANGE
        if name.startswith("goal_"):
            return self._goal_refusal(name, value)
        if name == "torque_enable" and value and self.hardware_error & self["shutdown"]:
            return StatusError.ACCESS
        return 0

    def _goal_refusal(self, name: str, value: int) -> int:
        if self._memory[_WATCHDOG] == 0xFF:
            return StatusError.DATA_RANGE
        if name == "goal_position":
            # Mode 5 counts turns: https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/#goal-position116
            low, high = -1_048_575, 1_048_575
            if self._memory[_MODE] == 3:
                high, low = struct.unpack_from("<II", self._memory, _LIMITS)
        else:
            limit = {"goal_velocity": "velocity_limit", "goal_current": "current_limit"}
            high = self[limit.get(name, "pwm_limit")]
            low = -high
        return 0 if low <= value <= high else StatusError.DATA_LIMIT

    def _take_effect(self, name: str, value: int) -> None:
        motors, i = self._motors, self.index
        if name == "goal_position":
            if self.torque_on:
                motors.goal[i] = value
        elif name == "bus_watchdog":
            self._set_patience()
        elif name == "torque_enable":
            self._set_torque(on=bool(value))
        elif name in ("profile_velocity", "profile_acceleration"):
            motors.set_profile(
                i,
                self["profile_velocity"] * VELOCITY_UNIT,
                self["profile_acceleration"] * ACCELERATION_UNIT,
            )
        elif name in ("goal_current", "operating_mode") and "goal_current" in self._registers:
            limited = self["operating_mode"] == 5
            motors.strength[i] = self._share_of_stall() if limited else 1.0

    def _share_of_stall(self) -> float:
        """What goal_current lets the motor do, as a share of its stall torque."""
        milliamperes = abs(self["goal_current"]) * (self.model.current_unit_ma or 0.0)
        return min(1.0, milliamperes / (self.model.stall_a * 1e3))

    def _set_torque(self, *, on: bool) -> None:
        motors, i = self._motors, self.index
        self["torque_enable"] = int(on)
        self._set_patience()
        motors.torque_on[i] = on
        if on:
            motors.trajectory[i] = motors.position[i]
            motors.goal[i] = self["goal_position"]

    def _refresh(self) -> None:
        """Bring the registers of the present up to date."""
        moving, *values = self._motors.register_values()[self.index]
        tick_ms = int((self._motors.now_s - self.booted_s) * 1e3) % 32768
        status = 0x32 if moving else 0x01
        _PRESENT.pack_into(self._memory, 120, tick_ms, moving, status, 0, *values)

    def _set_patience(self) -> None:
        setting = self["bus_watchdog"]
        armed = setting > 0 and self.torque_on
        self.patience_s = setting * _WATCHDOG_UNIT_S if armed else math.inf

    def _factory_settings(self, keep: Mapping[str, int] | None = None) -> None:
        self._memory[:] = bytes(len(self._memory))
        for name, value in self.model.defaults.items():
            self[name] = value
        self["model_number"] = self.model.model_number
        self["firmware_version"] = 52
        for name, value in (keep or {}).items():
            self[name] = value

    def _restart(self, now_s: float) -> None:
        """RAM back to defaults."""
        self._memory[64:] = bytes(len(self._memory) - 64)
        for name, value in self.model.defaults.items():
            if not self._registers[name].in_eeprom:
                self[name] = value
        self._table.reset_indirect()
        if "goal_current" in self._registers:
            self["goal_current"] = self["current_limit"]
        self.hardware_error = 0
        self.patience_s = math.inf
        self.booted_s = now_s
        motors, i = self._motors, self.index
        motors.torque_on[i] = False
        motors.overload_s[i] = 0.0
        motors.strength[i] = self._share_of_stall() if self["operating_mode"] == 5 else 1.0
        motors.set_profile(i, 0.0, 0.0)
        self["goal_position"] = round(motors.position[i])

    def _reset(self, parameters: bytes, now_s: float) -> int:
        if len(parameters) != 1:
            return StatusError.DATA_LENGTH
        kept = {0xFF: (), 1: ("id",), 2: ("id", "baud_rate")}.get(parameters[0])
        if kept is None:
            return StatusError.DATA_RANGE
        self._factory_settings({name: self[name] for name in kept})
        self.reboot(now_s)
        return 0
