"""One simulated Dynamixel: its control table, and its answers to instructions."""

import struct
from collections.abc import Mapping, Sequence
from typing import Final

from firmware_bridge.dynamixel.control_table import (
    RETURN_DELAY_UNIT_S,
    Register,
    ServoModel,
    baud_rates,
    register,
)
from firmware_bridge.dynamixel.wire.codec import ALERT_BIT, Instruction, StatusError
from firmware_bridge.simulator.drive import (
    CURRENT_BASED_POSITION,
    EXTENDED_POSITION,
    POSITION,
    REVERSED,
    SHAPING,
    TIMED_PROFILE,
    TORQUE_BY_GOAL,
    Drive,
)
from firmware_bridge.simulator.motors import Motors

#: The operating modes whose motion is simulated. Current, velocity and PWM control are not.
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


_GOAL: Final = register("goal_position").address
_PRESENT: Final = register("realtime_tick").address
_RAM: Final = register("torque_enable").address
#: Bit of startup_configuration: https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/#startup-configuration60
_TORQUE_AT_START: Final = 0x01
#: Parameters of the instruction clear: https://emanual.robotis.com/docs/en/dxl/protocol2/#clear
_CLEAR_REVOLUTIONS: Final = b"\x01\x44\x58\x4c\x22"
#: How long a restart and a factory reset take; not in the manual.
BOOT_S: Final = 0.5

Answer = tuple[int, bytes]


class SimulatedServo:
    """One simulated Dynamixel, over its model's control table; its motor is `motors[index]`.

    Simulated: ping, read, write, reg write, action, clear of turns, reboot, factory reset; sync and
    bulk instructions, which `SimulatedChain` hands out; indirect data, status return level, EEPROM
    lock and persistence, status errors 1, 2, 4, 5, 6, 7 and the alert bit, hardware errors that
    latch until reboot, bus watchdog; operating modes 3, 4 and 5 as far as the model has them, with
    what a change of mode resets; velocity- and time-based profiles, reverse mode, homing offset,
    torque on by goal update, torque on at start-up, goal PWM and goal current as limits.
    Refused with the instruction error: control table backup. So nothing is ever backed up, and RAM
    restore at start-up finds nothing to restore. Refused with the range error: modes 0, 1 and 16
    (current, velocity, PWM control), slave mode.
    Accepted without effect: gains, PWM slope, secondary id, protocol type, goal velocity, LED.

    servo[name] reads a register and puts a value into it, past all locks and checks, as a fault or
    a test may: the motor follows it, but torque is not switched and no goal pursued.
    """

    def __init__(self, model: ServoModel, servo_id: int, index: int, motors: Motors) -> None:
        """Make a servo with factory settings but for its id, just powered up.

        deaf_until_s: no packet is received before; booted_s, heard_s: when the servo was started,
        and received its last packet. `_registered`: the write that waits for an action.
        """
        self.model = model
        self.index = index
        self._drive = Drive(model, index, motors)
        self._modes = SIMULATED_MODES & set(model.modes)
        self._motors = motors
        self._registers = model.registers
        self._table = self._drive.table
        self._memory = self._table.bytes
        self._rates = baud_rates()
        self._registered = b""
        self.holds_at_start = False
        self.deaf_until_s = 0.0
        self.booted_s = 0.0
        self.heard_s = 0.0
        self._factory_settings({"id": servo_id})
        self.power_up(0.0)

    def __getitem__(self, name: str) -> int:
        if self._registers[name].address >= _PRESENT:
            self._drive.refresh(self.booted_s)
        return self._table[name]

    def __setitem__(self, name: str, value: int) -> None:
        self._table[name] = value
        if name in SHAPING:
            self._drive.settle()

    @property
    def servo_id(self) -> int:
        """The id of the servo, from its register."""
        return self._memory[7]

    @property
    def baud_rate(self) -> int:
        """The baud rate at which the servo listens, in bits/s."""
        return self._rates[self._memory[8]]

    @property
    def return_delay_s(self) -> float:
        """How many seconds the servo waits before it answers."""
        return self._memory[9] * RETURN_DELAY_UNIT_S

    @property
    def torque_on(self) -> bool:
        """Whether torque is on."""
        return self._drive.torque_on

    @property
    def answers_reads(self) -> bool:
        """Whether the status return level lets the servo answer reads."""
        return self._memory[68] >= 1

    @property
    def watchdog_timeout_s(self) -> float:
        """Seconds of silence after which the bus watchdog trips; infinity while it is off."""
        return self._drive.watchdog_timeout_s

    def stand_at(self, place: float) -> None:
        """Put the shaft and its goal where present_position reads `place`, in pulses."""
        self._drive.stand_at(place)

    def trip_watchdog(self) -> None:
        """Trip the bus watchdog: stop with torque on, and refuse goals until its register is 0."""
        self._drive.trip_watchdog()

    def lose_torque(self) -> None:
        """Switch torque off, as by a fault."""
        self._drive.set_torque(on=False)

    def latch(self, bits: int) -> None:
        """Set hardware error `bits` until a restart; torque goes off at those in `shutdown`."""
        known = self._memory[70]
        if bits & ~known:
            self["hardware_error_status"] = known | bits
            if bits & self["shutdown"]:
                self._drive.set_torque(on=False)

    def reboot(self, now_s: float) -> None:
        """Restart the servo: RAM and errors are reset, EEPROM is kept, .5 s without answers."""
        self.power_up(now_s)
        self.deaf_until_s = now_s + BOOT_S

    def ignore_until(self, time_s: float) -> None:
        """Receive nothing before `time_s`; infinity: never again."""
        self.deaf_until_s = time_s

    def start_up(self, now_s: float) -> None:
        """Switch torque on by the start-up configuration, once booted and if without an error."""
        if self.deaf_until_s <= now_s:
            self.holds_at_start = False
            self._drive.set_torque(on=not self._drive.broken)

    def answer(self, instruction: int, parameters: bytes, now_s: float) -> Answer | None:
        """Execute one instruction; return (error, data) of its status packet, None: no packet.

        A ping is always answered, a read from status return level 1 on, all else at level 2.
        """
        if instruction == Instruction.PING:
            return self._error(), struct.pack("<HB", self["model_number"], self["firmware_version"])
        if instruction == Instruction.READ:
            if not self.answers_reads:
                return None
            if len(parameters) != 4:
                return self._error(StatusError.DATA_LENGTH), b""
            return self.read_span(*struct.unpack("<HH", parameters))
        level = self["status_return_level"]
        if instruction == Instruction.WRITE:
            error = self.write(parameters)
        elif instruction == Instruction.REG_WRITE:
            error = self._register(parameters)
        elif instruction == Instruction.ACTION:
            error = self._act()
        elif instruction == Instruction.CLEAR:
            error = self._clear(parameters)
        elif instruction == Instruction.REBOOT:
            self.reboot(now_s)
            error = 0
        elif instruction == Instruction.FACTORY_RESET:
            error = self._reset(parameters, now_s)
        else:
            error = StatusError.INSTRUCTION
        return (self._error(error), b"") if level == 2 else None

    def read_span(self, address: int, size: int) -> Answer:
        """Return (error, data) for a read of `size` bytes at `address`, alone or in a group.

        An invalid address or size is an access error without data.
        """
        if size < 1 or address + size > len(self._memory):
            return self._error(StatusError.ACCESS), b""
        if address + size > _PRESENT:
            self._drive.refresh(self.booted_s)
        data = self._table.shown(address, size)
        return self._error(), data

    def write(self, parameters: bytes) -> int:
        """Write parameters (address, data) to registers, all or none; return the status error."""
        if len(parameters) < 3:
            return StatusError.DATA_LENGTH
        address, data = parameters[0] | parameters[1] << 8, parameters[2:]
        if address == _GOAL and len(data) == 4:  # a goal position, as nearly every write is
            goal = int.from_bytes(data, "little", signed=True)
            error = self._refusal_of_goal(goal)
            if not error:
                self._memory[_GOAL : _GOAL + 4] = data
                self._drive.pursue(goal)
            return error
        pieces = self._table.pieces(address, data, locked=self.torque_on)
        if isinstance(pieces, StatusError):
            return pieces
        if error := self._refusal_of_all(pieces):
            return error
        for entry, value in pieces:
            self._set(entry.name, value)
        if not pieces:
            self._memory[address : address + len(data)] = data  # indirect addresses
        return 0

    def _refusal_of_all(self, pieces: Sequence[tuple[Register, int]]) -> int:
        """Return the first status error against writing `pieces` (register, value); 0: none.

        Besides errors of single registers: a lower position limit above the upper one.
        """
        for entry, value in pieces:
            if error := self._refusal_of_one(entry, value):
                return error
        values = {entry.name: value for entry, value in pieces}
        if "min_position_limit" in values or "max_position_limit" in values:
            low = values.get("min_position_limit", self._table["min_position_limit"])
            high = values.get("max_position_limit", self._table["max_position_limit"])
            if low > high:
                return StatusError.DATA_LIMIT
        return 0

    def _refusal_of_goal(self, goal: int) -> int:
        """Return the status error against writing a goal position; 0: it is allowed.

        Refused is a goal outside the range, and any goal while the watchdog has tripped.
        """
        if self._memory[_WATCHDOG] == _TRIPPED:
            return StatusError.DATA_RANGE
        low, high = -_FARTHEST, _FARTHEST
        if self._memory[_MODE] == POSITION:  # the upper limit comes first in the table
            high, low = struct.unpack_from("<II", self._memory, _LIMITS)
        return 0 if low <= goal <= high else StatusError.DATA_LIMIT

    def _refusal_of_one(self, entry: Register, value: int) -> int:
        """Return the status error against writing `value` to one register; 0: it is allowed.

        Refused are EEPROM with torque on, values out of range, goals above their limit or while the
        watchdog has tripped, and torque on after a hardware error.
        """
        name, table = entry.name, self._table
        if entry.in_eeprom and self._drive.torque_on:
            return StatusError.ACCESS
        if entry.low is not None and not entry.low <= value <= (entry.high or 0):
            return StatusError.DATA_RANGE
        if name == "goal_position":
            return self._refusal_of_goal(value)
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

    def _set(self, name: str, value: int) -> None:
        """Write one register, with all effects of a write on the motor; the value was checked."""
        drive = self._drive
        if name == "torque_enable":
            drive.set_torque(on=bool(value))
            return
        changed = self._table[name] != value
        self[name] = value
        if name == "goal_position":
            drive.pursue(value)
        elif name == "operating_mode" and changed:
            drive.change_mode()

    def _register(self, parameters: bytes) -> int:
        """Obey the instruction reg write: keep the write for the next action.

        Return the status error, with which the write is not kept; 0: none.
        """
        if len(parameters) < 3:
            return StatusError.DATA_LENGTH
        address, data = parameters[0] | parameters[1] << 8, parameters[2:]
        pieces = self._table.pieces(address, data, locked=self.torque_on)
        error = pieces if isinstance(pieces, StatusError) else self._refusal_of_all(pieces)
        if not error:
            self._registered = parameters
            self["registered_instruction"] = 1
        return error

    def _act(self) -> int:
        """Do the kept write and return its status error; the instruction error if none is kept."""
        if not self._registered:
            return StatusError.INSTRUCTION
        parameters, self._registered = self._registered, b""
        self["registered_instruction"] = 0
        return self.write(parameters)

    def _clear(self, parameters: bytes) -> int:
        """Obey the instruction clear: forget whole turns; return the status error.

        The error is RESULT_FAIL while the servo moves.
        """
        if parameters != _CLEAR_REVOLUTIONS:
            return StatusError.DATA_RANGE
        if self["moving"]:
            return StatusError.RESULT_FAIL
        self._drive.count_one_turn()
        self._drive.stand_at(self._drive.place)
        return 0

    def _error(self, error: int = 0) -> int:
        return error | (ALERT_BIT if self._memory[70] else 0)

    def _factory_settings(self, keep: Mapping[str, int]) -> None:
        """Set all registers to the model's defaults; keep: values of registers that differ."""
        self._memory[:] = bytes(len(self._memory))
        identity = {"model_number": self.model.model_number, "firmware_version": 52}
        for name, value in {**self.model.defaults, **identity, **keep}.items():
            self._table[name] = value

    def power_up(self, now_s: float) -> None:
        """Set the state after power-up: RAM at defaults, EEPROM kept, limp, goal = position."""
        self._memory[_RAM:] = bytes(len(self._memory) - _RAM)
        for name, value in self.model.defaults.items():
            if not self._registers[name].in_eeprom:
                self._table[name] = value
        self._table.reset_indirect()
        self._registered = b""
        self.booted_s = now_s
        self._drive.set_torque(on=False)
        self._drive.reset_goals()
        self._motors.overload_s[self.index] = 0.0
        self.holds_at_start = bool(self["startup_configuration"] & _TORQUE_AT_START)

    def _reset(self, parameters: bytes, now_s: float) -> int:
        """Obey the instruction factory reset, then restart; return the status error.

        parameters: one byte. 0xFF: reset all registers; 1: all but the id; 2: all but id and baud
        rate.
        """
        if len(parameters) != 1:
            return StatusError.DATA_LENGTH
        kept = {0xFF: (), 1: ("id",), 2: ("id", "baud_rate")}.get(parameters[0])
        if kept is None:
            return StatusError.DATA_RANGE
        self._factory_settings({name: self[name] for name in kept})
        self.reboot(now_s)
        return 0
