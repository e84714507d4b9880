"""The control table of one simulated servo, and the effect of its registers on the motor."""

import math
import struct
from typing import Final

from firmware_bridge.dynamixel.control_table import (
    WATCHDOG_UNIT_S,
    IndirectBlock,
    Register,
    ServoModel,
    register,
)
from firmware_bridge.dynamixel.wire.codec import StatusError
from firmware_bridge.simulator.motors import FULL_PWM, VELOCITY_UNIT, Motors, Profile


class RegisterMemory:
    """The registers of one servo: values by name, and reads and writes by address by its rules."""

    def __init__(self, model: ServoModel) -> None:
        self.bytes = bytearray(model.table_size)
        self._indirect = model.indirect
        self._registers = model.registers
        self._by_address = {r.address: r for r in model.registers.values()}

    def __getitem__(self, name: str) -> int:
        register = self._registers[name]
        return register.decode(bytes(self.bytes[register.address : register.end]))

    def __setitem__(self, name: str, value: int) -> None:
        register = self._registers[name]
        self.bytes[register.address : register.end] = register.encode(value)

    def shown(self, address: int, size: int) -> bytes:
        """Return the `size` bytes that a read from `address` on gets, indirect data resolved.

        Indirect data: bytes that show those of the registers to which indirect addresses point.
        Call `Drive.refresh` before, for present values.
        """
        shown = self.bytes[address : address + size]
        for block in self._indirect:
            end = min(address + size, block.data + block.count)
            for at in range(max(address, block.data), end):
                shown[at - address] = self.bytes[self._behind(block, at)]
        return bytes(shown)

    def reset_indirect(self) -> None:
        """Map every indirect address to its own data byte, as after power-up."""
        for block in self._indirect:
            for n in range(block.count):
                struct.pack_into("<H", self.bytes, block.addresses + 2 * n, block.data + n)

    def pieces(
        self, address: int, data: bytes, *, locked: bool
    ) -> list[tuple[Register, int]] | StatusError:
        """Return the registers that a write changes, with their values, or the write's error.

        Changes nothing. Indirect data is resolved. []: an allowed write of indirect addresses,
        whose bytes the caller puts into memory. locked: whether torque is on, so that indirect
        addresses cannot be changed.
        """
        for block in self._indirect:
            if block.data <= address < block.data + block.count:
                return self._indirect_pieces(block, address, data)
            if block.addresses <= address < block.addresses + 2 * block.count:
                return StatusError.ACCESS if locked else self._mapping_refusal(block, address, data)
        pieces = []
        end = address + len(data)
        at = address
        while at < end:
            register = self._by_address.get(at)
            if register is None or not register.writable:
                return StatusError.ACCESS
            if register.end > end:
                return StatusError.DATA_LENGTH
            pieces.append((register, register.decode(data[at - address : register.end - address])))
            at = register.end
        return pieces

    def _indirect_pieces(
        self, block: IndirectBlock, address: int, data: bytes
    ) -> list[tuple[Register, int]] | StatusError:
        """Return the registers, with values, that a write of indirect data changes, or an error.

        Every register must be written whole.
        """
        if address + len(data) > block.data + block.count:
            return StatusError.ACCESS
        # the bytes to write, by the addresses pointed to
        shown = {self._behind(block, at): byte for at, byte in enumerate(data, start=address)}
        pieces = []
        for entry in self._registers.values():
            behind = [n for n in range(entry.address, entry.end) if n in shown]
            if not behind:
                continue
            if not entry.writable:
                return StatusError.ACCESS
            if len(behind) < entry.size:
                return StatusError.DATA_LENGTH
            pieces.append((entry, entry.decode(bytes(shown[n] for n in behind))))
        return pieces

    def _mapping_refusal(
        self, block: IndirectBlock, address: int, data: bytes
    ) -> list[tuple[Register, int]] | StatusError:
        """Return the status error against a write of indirect addresses; []: it is allowed."""
        if (address - block.addresses) % 2 or len(data) % 2:
            return StatusError.DATA_LENGTH
        targets = struct.unpack(f"<{len(data) // 2}H", data)
        if address + len(data) > block.addresses + 2 * block.count:
            return StatusError.ACCESS
        # Only RAM, which begins at address 64, can be pointed to.
        if not all(64 <= target < len(self.bytes) for target in targets):
            return StatusError.DATA_RANGE
        return []

    def _behind(self, block: IndirectBlock, at: int) -> int:
        """Return the address to which the data byte at the address `at` of the block points.

        The n-th data byte shows the byte to which the n-th indirect address points.
        """
        pointer = block.addresses + 2 * (at - block.data)
        return self.bytes[pointer] | self.bytes[pointer + 1] << 8


#: Bits of drive_mode: https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/#drive-mode10
REVERSED, TIMED_PROFILE, TORQUE_BY_GOAL = 0x01, 0x04, 0x08
#: Operating modes: position in one turn, position over many turns, the same with limited current.
POSITION, EXTENDED_POSITION, CURRENT_BASED_POSITION = 3, 4, 5
_WATCHDOG_TRIPPED: Final = -1
_DRIVE_MODE, _TORQUE = register("drive_mode").address, register("torque_enable").address
#: realtime_tick .. present_temperature
_PRESENT: Final = struct.Struct("<HBBhhiiiiHB")
_PRESENT_ADDRESS: Final = register("realtime_tick").address
#: Registers from which `settle` works out what it sets.
SHAPING: Final = frozenset(
    {
        *("drive_mode", "operating_mode", "homing_offset", "moving_threshold", "bus_watchdog"),
        *("profile_velocity", "profile_acceleration"),
        *("goal_pwm", "pwm_limit", "goal_current", "current_limit"),
    }
)


class Drive:
    """Registers and motor of one simulated servo, number `index` of `motors`.

    The manual does not say about which position reverse mode mirrors; here it is the middle, so
    that one turn stays one turn.
    """

    def __init__(self, model: ServoModel, index: int, motors: Motors) -> None:
        """Make the registers of a `model`, all 0; its motor is number `index` of `motors`.

        `_sign`, `_zero`: present_position is `_sign` x the motor's position + `_zero`.
        """
        self.index = index
        self.motors = motors
        self.table = RegisterMemory(model)
        #: The silence after which the watchdog trips; infinity while it is off.
        self.watchdog_timeout_s = math.inf
        self._memory = self.table.bytes
        self._model = model
        self._turn = model.n_positions
        self._has_current = "goal_current" in model.registers
        self._n_revolutions = 0
        self._sign, self._zero = 1.0, 0.0
        self._profile = Profile(False, 0, 0)
        self._profile_is_new = True

    @property
    def torque_on(self) -> bool:
        """Whether torque is on."""
        return self._memory[_TORQUE] == 1

    @property
    def broken(self) -> bool:
        """Whether a hardware error keeps torque off until the next restart."""
        return bool(self.table["hardware_error_status"] & self.table["shutdown"])

    @property
    def place(self) -> float:
        """The shaft's position, in pulses of present_position, unrounded."""
        return float(self.motors.position[self.index] * self._sign + self._zero)

    def stand_at(self, place: float) -> None:
        """Put the shaft and its goal where present_position reads `place`, in pulses."""
        motors, i = self.motors, self.index
        motors.position[i] = motors.trajectory[i] = motors.goal[i] = self._shaft(place)
        self.table["goal_position"] = round(place)
        motors.shown_at_s = -1.0

    def settle(self) -> None:
        """Apply the registers in `SHAPING` (modes, offset, profile, limits) to the motor.

        To be called after each change of one of them. A changed profile counts from the next goal
        on.
        """
        table, motors, i = self.table, self.motors, self.index
        drive_mode = table["drive_mode"]
        offset = table["homing_offset"]
        # Position control ignores an offset of more than 90 degrees:
        # https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/#homing-offset20
        if table["operating_mode"] == POSITION and abs(offset) > self._turn // 4:
            offset = 0
        reversed_ = bool(drive_mode & REVERSED)
        self._sign = -1.0 if reversed_ else 1.0
        self._zero = float(offset + (reversed_ - self._n_revolutions) * self._turn)
        motors.sign[i], motors.zero[i] = self._sign, self._zero
        timed = bool(drive_mode & TIMED_PROFILE)
        profile = Profile(timed, table["profile_velocity"], table["profile_acceleration"])
        self._profile_is_new |= profile != self._profile
        self._profile = profile
        pwm = min(abs(table["goal_pwm"]), table["pwm_limit"]) / FULL_PWM
        motors.strength[i] = min(pwm, self._share_of_stall())
        motors.free_speed[i] = pwm * motors.no_load[i]
        motors.moving_speed[i] = table["moving_threshold"] * VELOCITY_UNIT
        self.set_watchdog_timeout()
        motors.shown_at_s = -1.0

    def _share_of_stall(self) -> float:
        """Return the torque that goal_current allows, as a share of the stall torque, 0..1."""
        if not self._has_current or self.table["operating_mode"] != CURRENT_BASED_POSITION:
            return 1.0
        units = min(abs(self.table["goal_current"]), self.table["current_limit"])
        return min(1.0, units * (self._model.current_unit_ma or 0.0) / (self._model.stall_a * 1e3))

    def count_one_turn(self) -> None:
        """Forget whole turns: the position is within the first again, plus the homing offset."""
        counted = float(self.motors.position[self.index]) * self._sign
        self._n_revolutions = math.floor(counted / self._turn) + (self._sign < 0)
        self.settle()

    def pursue(self, goal: int) -> None:
        """Start the motor's motion to `goal`, in pulses of the register; without torque do nothing.

        But a drive mode with "torque on by goal update" then switches torque on, unless the servo
        is `broken`.
        """
        if not self._memory[_TORQUE]:
            if self._memory[_DRIVE_MODE] & TORQUE_BY_GOAL and not self.broken:
                self.set_torque(on=True)
            return
        motors, i = self.motors, self.index
        shaft = (goal - self._zero) * self._sign  # in the motor's pulses
        if self._profile.depends_on_distance:
            way = shaft - float(motors.trajectory[i])
            speed = float(motors.trajectory_velocity[i])  # below: positive towards the goal
            course = self._profile.course(abs(way), math.copysign(speed, speed * way))
            motors.set_course(i, course)
        elif self._profile_is_new:
            motors.set_course(i, self._profile.course(0.0))
        self._profile_is_new = False
        motors.goal[i] = shaft
        motors.shown_at_s = -1.0

    def set_torque(self, *, on: bool) -> None:
        """Switch torque on or off; when it comes on, the motor runs to the goal in the register.

        In position mode (one turn) whole turns are forgotten first. A motor whose torque is on
        already goes on as before.
        """
        motors, i = self.motors, self.index
        was_on = self.torque_on
        self._memory[_TORQUE] = on
        self.set_watchdog_timeout()
        motors.torque_on[i] = on
        motors.shown_at_s = -1.0
        if on and not was_on:
            if self.table["operating_mode"] == POSITION:
                self.count_one_turn()
            motors.trajectory[i] = motors.position[i]
            motors.trajectory_velocity[i] = 0.0
            self.pursue(self.table["goal_position"])

    def change_mode(self) -> None:
        """Reset gains, profile and goals, as a change of the operating mode does.

        https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/#operating-mode11
        The manual states gains of mode 3 alone, so the other modes have the same. It does not say
        what becomes of the goal; here it is the present position, as after a restart.
        """
        for name, value in self._model.defaults.items():
            if name.endswith("_gain"):
                self.table[name] = value
        self.table["profile_velocity"] = self.table["profile_acceleration"] = 0
        self.reset_goals()

    def reset_goals(self) -> None:
        """Set goal PWM and goal current to their limits, goal position to the present position."""
        self.table["goal_pwm"] = self.table["pwm_limit"]
        if self._has_current:
            self.table["goal_current"] = self.table["current_limit"]
        self.settle()
        self.count_one_turn()
        self.stand_at(self.place)

    def trip_watchdog(self) -> None:
        """Trip the bus watchdog: stop at the present position, with torque on.

        Goals are refused until 0 is written to the register bus_watchdog.
        """
        self.table["bus_watchdog"] = _WATCHDOG_TRIPPED
        self.set_watchdog_timeout()
        self.motors.stop(self.index)

    def set_watchdog_timeout(self) -> None:
        """Compute the bus watchdog's timeout from its register; infinity if 0 or torque is off."""
        setting = self.table["bus_watchdog"]
        armed = setting > 0 and self.torque_on
        self.watchdog_timeout_s = setting * WATCHDOG_UNIT_S if armed else math.inf

    def refresh(self, booted_s: float) -> None:
        """Write the motor's present values (position, current, ...) into their registers.

        booted_s: the time of the servo's last start, for realtime_tick.
        """
        values = self.motors.register_values()[self.index]
        tick_ms = int((self.motors.now_s - booted_s) * 1e3) % 32768
        _PRESENT.pack_into(self._memory, _PRESENT_ADDRESS, tick_ms, *values)

    def _shaft(self, place: float) -> float:
        return (place - self._zero) * self._sign
