"""A simulated chain of Feetech servos, to the byte; in memory or behind a pseudo-terminal.

The simulator itself logs every change of torque and goal: tests judge by that log.
"""

import random
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, Literal

from firmware_bridge.bus_kinds import Wiring
from firmware_bridge.bus_settings import within
from firmware_bridge.clock import ManualClock
from firmware_bridge.feetech.bus import FeetechBus
from firmware_bridge.feetech.codec import BROADCAST_ID, Instruction, packet, packets_in
from firmware_bridge.feetech.control_table import (
    EEPROM_SIZE,
    RETURN_DELAY_UNIT_S,
    SPEED_IN_STEPS,
    STATE,
    TORQUE_ENABLE,
    ServoModel,
    baud_rates,
    servo_models,
)
from firmware_bridge.feetech.mounting import MountedServo, mounted_servos
from firmware_bridge.feetech.provisioning import wanted_settings
from firmware_bridge.serial_servos.half_duplex import BITS_PER_BYTE
from firmware_bridge.simulation_request import DueFaults, SimulationRequest, TimedFault
from firmware_bridge.simulator.motors import (
    CENTER_PULSE,
    PULSES_PER_DEG,
    UNBOUNDED,
    Course,
    Environment,
    Motors,
)
from firmware_bridge.simulator.ports import MemoryTransport, PtyHost

#: A ping: lipservo never sends it, other programs do.
_PING: Final = 0x01
_TABLE_SIZE: Final = 96
#: Written to torque_enable: the present position becomes the middle of the range.
_MIDDLE: Final = 128
#: How long a restart takes; our assumption.
_BOOT_S: Final = 0.2
#: Steps a second, and a second squared, of one unit of goal_speed and acceleration.
_SPEED_STEPS, _ACCELERATION_STEPS = 50, 100
#: Bits of register `status`, at address 65.
_OVERLOAD, _VOLTAGE, _HEAT = 0x20, 0x01, 0x04
#: Registers of a new servo; phase: speeds count single steps, and speed 0 is as fast as possible.
_FACTORY: Final = {
    "firmware_major": 3,
    "firmware_minor": 10,
    "id": 1,
    "response_status_level": 1,
    "max_temperature": 70,
    "max_voltage": 140,
    "min_voltage": 40,
    "max_torque": 1000,
    "phase": 0x0C,
    "unloading_condition": 0x2C,
    "protective_torque": 20,
    "protection_time": 200,
    "overload_torque": 80,
}


class ChainFault(TimedFault):
    """A simulated fault, which lasts `lasts_s`; `locked` lasts for ever.

    servo: its index in the chain; None: all servos. A brown-out is a restart that takes .2 s.
    """

    kind: Literal[
        "lost", "spoilt", "silence", "brown-out", "restart", "overload", "jam", "locked", "unplug"
    ]
    servo: Annotated[int, within(0, 253)] | None = None


@dataclass(frozen=True, slots=True)
class ServoChange:
    """A change of torque or goal of one servo, and its position at that time, in its steps."""

    time_s: float
    servo_id: int
    torque: int
    goal: int
    place: int


class SimulatedServo:
    """One simulated servo: its control table, whose motor has number `index` in `motors`.

    A goal switches torque on, as in real servos. wakes_up_stiff: torque is on after power-up.
    """

    def __init__(
        self, model: ServoModel, index: int, motors: Motors, *, wakes_up_stiff: bool = False
    ) -> None:
        """Make a servo with factory settings, just powered up.

        table: all registers by address; stored: those that survive power-off. silent_until_s: the
        servo ignores packets before. `_scale`: steps of `motors` per step of the position register.
        """
        self.model, self.dialect, self.index = model, model.dialect, index
        self._motors, self._wakes_up_stiff = motors, wakes_up_stiff
        self.table = bytearray(_TABLE_SIZE)
        self.silent_until_s = 0.0
        self.stays_locked = False
        self._scale = PULSES_PER_DEG / self.dialect.positions_per_deg
        for name, value in _FACTORY.items():
            if name in self.dialect.registers:
                self[name] = value
        self.table[2] = self.dialect.byte_order == "big"
        self["model_number"] = model.model_number
        self["max_position_limit"] = self.dialect.n_positions - 1
        self.stored = bytes(self.table[:EEPROM_SIZE])
        self.power_up()

    def __getitem__(self, name: str) -> int:
        return self.dialect.decode(name, bytes(self.table))

    def __setitem__(self, name: str, value: int) -> None:
        """Set a register despite all locks, for faults and tests."""
        entry = self.dialect.registers[name]
        self.table[entry.address : entry.address + entry.size] = self.dialect.encode(name, value)
        if entry.address < EEPROM_SIZE:
            self.stored = bytes(self.table[:EEPROM_SIZE])

    @property
    def baud_rate(self) -> int:
        """The baud rate at which the servo listens; 0 for an invalid code."""
        return baud_rates().get(self["baud_rate"], 0)

    @property
    def place(self) -> int:
        """The value of the servo's position register."""
        shaft = float(self._motors.position[self.index])
        return round((shaft - CENTER_PULSE) / self._scale) + self.dialect.center

    def stand_at(self, place: int) -> None:
        """Move shaft and goal at once to where the position register reads `place`."""
        motors, i = self._motors, self.index
        motors.position[i] = motors.trajectory[i] = motors.goal[i] = self._shaft(place)
        self["goal_position"] = place

    def power_up(self) -> None:
        """Reset all registers outside the EEPROM, as after power was off."""
        self.table[:EEPROM_SIZE] = self.stored
        self.table[EEPROM_SIZE:] = bytes(_TABLE_SIZE - EEPROM_SIZE)
        self["lock"] = 1
        if "torque_limit" in self.dialect.registers:
            self["torque_limit"] = self["max_torque"]
        self._set_torque(1 if self._wakes_up_stiff else 0)
        self.stand_at(self.place)
        self._settle()

    def read(self, address: int, size: int) -> bytes:
        """Return `size` bytes of the registers from `address` on, with up-to-date measurements."""
        if address + size > STATE:
            self._refresh()
        return bytes(self.table[address : address + size])

    def write(self, address: int, data: bytes) -> None:
        """Write registers as a packet would: read-only ones stay, EEPROM lasts only if unlocked.

        A write of the goal switches torque on. Positions outside the limits are clipped.
        """
        lock = self.dialect.registers["lock"].address
        # Addresses below 5 and from `STATE` on are read-only; torque and lock follow below.
        for at, byte in enumerate(data, start=address):
            if at in (TORQUE_ENABLE, lock) or not 5 <= at < STATE:
                continue
            self.table[at] = byte
        end = address + len(data)
        if address <= lock < end and not self.stays_locked:
            self.table[lock] = data[lock - address]
        if address < EEPROM_SIZE and not self["lock"]:
            self.stored = bytes(self.table[:EEPROM_SIZE])
        if address <= TORQUE_ENABLE < end:
            self._set_torque(data[TORQUE_ENABLE - address])
        goal = self.dialect.registers["goal_position"].address
        if address < goal + 2 and goal < end:
            if not self.table[TORQUE_ENABLE]:
                self._set_torque(1)
            low, high = self["min_position_limit"], self["max_position_limit"]
            self._motors.goal[self.index] = self._shaft(min(max(self["goal_position"], low), high))
        self._settle()

    def protect(self) -> None:
        """Update register `status`, whose error bits every answer has, after the motor moved.

        Voltage and heat are of the present; an overload lasts until torque goes off.
        """
        motors, i = self._motors, self.index
        status = self.table[65] & _OVERLOAD
        if motors.overload_s[i] >= self["protection_time"] * 0.01:
            status |= _OVERLOAD
        volts = motors.voltage_v[i] * 10.0
        status |= 0 if self["min_voltage"] <= volts <= self["max_voltage"] else _VOLTAGE
        status |= _HEAT if motors.temperature[i] > self["max_temperature"] else 0
        if status != self.table[65]:
            self.table[65] = status
            self._settle()

    def _set_torque(self, value: int) -> None:
        """Switch torque on (`value` 1) or off; 128: make the present position the range's middle.

        Torque off ends an overload. Torque that comes on holds the present position.
        """
        motors, i = self._motors, self.index
        if value == _MIDDLE:
            motors.position[i] = motors.trajectory[i] = CENTER_PULSE
            return
        self.table[TORQUE_ENABLE] = value
        on = value == 1
        if on != bool(motors.torque_on[i]):
            motors.torque_on[i] = on
            motors.trajectory[i], motors.trajectory_velocity[i] = motors.position[i], 0.0
            motors.goal[i] = motors.position[i]
        if not on:
            self.table[65] &= ~_OVERLOAD
            motors.overload_s[i] = 0.0

    def _settle(self) -> None:
        """Set the motor's speed, acceleration and strength from the registers, after a change.

        During an overload the strength is that of register protective_torque at most.
        """
        motors, i, of = self._motors, self.index, self.dialect.registers
        speed = abs(self["goal_speed"])
        # fine: goal_speed counts single steps a second, else 50; speed or acceleration 0: no limit
        fine = "homing_offset" not in of or self["phase"] & SPEED_IN_STEPS
        steps_s = speed if fine else speed * _SPEED_STEPS
        rise = self["acceleration"] * _ACCELERATION_STEPS if "acceleration" in of else 0
        top = steps_s * self._scale if speed else UNBOUNDED
        motors.set_course(i, Course(top, rise * self._scale if rise else UNBOUNDED, 0))
        strength = self["torque_limit" if "torque_limit" in of else "max_torque"] / 1000.0
        if self.table[65] & _OVERLOAD:
            strength = min(strength, self["protective_torque"] / 100.0)
        motors.strength[i] = min(strength, 1.0)

    def _refresh(self) -> None:
        """Write the motor's present position, load, voltage, heat and current into registers."""
        motors, i = self._motors, self.index
        motors.shown_at_s = -1.0
        # effort: current in the register's unit, or load in 0.1 %; share: of the stall torque
        effort = motors.register_values()[i][3]
        unit_ma = self.model.current_unit_ma
        share = effort * 1e-3 if unit_ma is None else effort * unit_ma * 1e-3 / self.model.stall_a
        self["present_position"] = self.place
        self["present_load"] = max(-1000, min(1000, round(share * 1000.0)))
        self["present_voltage"] = max(0, min(255, round(motors.voltage_v[i] * 10.0)))
        self["present_temperature"] = max(0, min(255, round(motors.temperature[i])))
        if unit_ma is not None:
            self["present_current"] = effort

    def _shaft(self, place: int) -> float:
        return (place - self.dialect.center) * self._scale + CENTER_PULSE


@dataclass(slots=True)
class _Reply:
    start_s: float
    end_s: float
    data: bytes


class SimulatedChain:
    """A `SimulatedDevice`: servos on one half-duplex wire. `changes`: the log that tests read.

    n_spoken_over: how often one device sent while another did.
    """

    def __init__(
        self,
        models: Sequence[ServoModel],
        ids: Sequence[int],
        *,
        faults: Sequence[ChainFault] = (),
        wakes_up_stiff: bool = False,
        environment: Environment | None = None,
        on_change: Callable[[ServoChange], None] = lambda _change: None,
    ) -> None:
        """Make a servo of each of `models`, with the id in `ids`, otherwise factory settings.

        faults: happen at their times. wakes_up_stiff: torque is on after power-up. on_change:
        called at each change of torque or goal.
        """
        self.motors = Motors(models, environment or Environment())
        self.servos = [
            SimulatedServo(model, n, self.motors, wakes_up_stiff=wakes_up_stiff)
            for n, model in enumerate(models)
        ]
        for servo, servo_id in zip(self.servos, ids, strict=True):
            servo["id"] = servo_id
        self.changes: deque[ServoChange] = deque(maxlen=100_000)
        self.n_spoken_over = 0
        self._on_change = on_change
        self._logged: dict[int, tuple[int, int]] = {}
        self._faults = DueFaults(faults)
        self._until_s = {"lost": -1.0, "spoilt": -1.0, "unplug": -1.0}
        self._ends: list[tuple[float, SimulatedServo]] = []
        self._rng = random.Random(0)
        self._now_s = self._host_until_s = self._wire_until_s = 0.0
        self._heard = b""
        self._replies: list[_Reply] = []

    @property
    def plugged(self) -> bool:
        """Whether the chain's port exists; False during a fault `unplug`."""
        return self._now_s >= self._until_s["unplug"]

    @property
    def next_delivery_s(self) -> float:
        """The time at which the next bytes reach the computer; infinity: none are under way."""
        return min((reply.end_s for reply in self._replies), default=float("inf"))

    def advance(self, now_s: float) -> None:
        """Simulate all servos and due faults up to `now_s`."""
        if now_s <= self._now_s:
            return
        for at_s, fault in self._faults.take(now_s):
            self._now_s = max(self._now_s, at_s)
            self.motors.advance(self._now_s)
            self._happen(fault, self._now_s)
        for end_s, servo in [each for each in self._ends if each[0] <= now_s]:
            self._ends.remove((end_s, servo))
            self.motors.load[servo.index], self.motors.jammed[servo.index] = 0.0, False
        self._now_s = now_s
        self.motors.advance(now_s)
        for servo in self.servos:
            servo.protect()

    def receive(self, data: bytes, now_s: float, baud_rate: int) -> None:
        """Process bytes that the computer writes at `now_s`, at its baud rate.

        Whole packets are carried out when their last byte is on the wire. Answers that are on the
        wire at the same time are destroyed. While unplugged, nothing is received.
        """
        self.advance(now_s)
        if not self.plugged:
            return
        byte_s = BITS_PER_BYTE / baud_rate
        start_s = max(now_s, self._host_until_s)
        self._host_until_s = start_s + len(data) * byte_s
        for reply in self._replies:
            if reply.start_s < self._host_until_s and start_s < reply.end_s - 1e-9:
                self.n_spoken_over += 1
                reply.data = bytes(len(reply.data))
        # pending: bytes of an unfinished packet received before; done: those carried out now
        pending = len(self._heard)
        self._heard += data
        done = 0
        for frame, end in packets_in(self._heard):
            if frame is not None:
                done = end
                end_s = start_s + (end - pending) * byte_s
                self._hear(frame.servo_id, frame.error, frame.data, end_s, baud_rate)
        self._heard = self._heard[done:][-_TABLE_SIZE:]

    def deliver(self, now_s: float) -> bytes:
        """Return the bytes that have reached the computer by `now_s`."""
        due = [reply for reply in self._replies if reply.end_s <= now_s]
        self._replies = [reply for reply in self._replies if reply.end_s > now_s]
        return b"".join(reply.data for reply in sorted(due, key=lambda each: each.end_s))

    def _happen(self, fault: ChainFault, now_s: float) -> None:
        """Apply a fault of the script that begins at `now_s`."""
        end_s = now_s + fault.lasts_s
        # `lost`, `spoilt` and `unplug` hit all answers, the other kinds single servos.
        if fault.kind in self._until_s:
            self._until_s[fault.kind] = end_s
            self._replies.clear()
            return
        servos = self.servos if fault.servo is None else self.servos[fault.servo : fault.servo + 1]
        for servo in servos:
            if fault.kind == "silence":
                servo.silent_until_s = end_s
            elif fault.kind in ("brown-out", "restart"):
                servo.power_up()
                servo.silent_until_s = end_s if fault.kind == "restart" else now_s + _BOOT_S
                self._log(servo)
            elif fault.kind == "locked":
                servo.stays_locked = True
            else:  # overload or jam; `advance` ends it
                self.motors.load[servo.index] = 0.95
                self.motors.jammed[servo.index] = fault.kind == "jam"
                self._ends.append((end_s, servo))

    def _hear(
        self, packet_id: int, instruction: int, parameters: bytes, end_s: float, baud_rate: int
    ) -> None:
        """Carry out a packet whose last byte is received at `end_s`, and queue the servos' answers.

        baud_rate: the computer's; servos set to another rate do not receive the packet.
        """
        self.advance(end_s)
        self._wire_until_s = end_s
        byte_s = BITS_PER_BYTE / baud_rate
        listening = [
            s for s in self.servos if s.baud_rate == baud_rate and s.silent_until_s <= end_s
        ]
        own = [s for s in listening if s["id"] == packet_id]
        # Sync write: address, size, then id and data of each servo. Sync read: address, size, ids.
        if instruction == Instruction.SYNC_WRITE and len(parameters) > 2:
            address, size = parameters[0], parameters[1]
            for at in range(2, len(parameters) - size, size + 1):
                for servo in listening:
                    if servo["id"] == parameters[at]:
                        servo.write(address, parameters[at + 1 : at + 1 + size])
                        self._log(servo)
        elif instruction == Instruction.SYNC_READ and len(parameters) > 2:
            for servo_id in parameters[2:]:
                addressed = [s for s in listening if s["id"] == servo_id and s.dialect.sync_read]
                start_s = self._wire_until_s
                for servo in addressed:
                    self._say(servo, servo.read(*parameters[:2]), start_s, byte_s)
                # Those behind a silent one wait for as long as it would have spoken.
                if not addressed:
                    self._wire_until_s += (6 + parameters[1]) * byte_s
        elif instruction == Instruction.WRITE and parameters:
            for servo in listening if packet_id == BROADCAST_ID else own:
                answers = servo["response_status_level"] and packet_id != BROADCAST_ID
                servo.write(parameters[0], parameters[1:])
                self._log(servo)
                if answers:
                    self._say(servo, b"", end_s, byte_s, packet_id)
        elif instruction == Instruction.READ and len(parameters) == 2:
            for servo in own:
                self._say(servo, servo.read(*parameters), end_s, byte_s)
        elif instruction == _PING:
            for servo in own:
                self._say(servo, b"", end_s, byte_s)

    def _say(
        self,
        servo: SimulatedServo,
        data: bytes,
        after_s: float,
        byte_s: float,
        servo_id: int | None = None,
    ) -> None:
        """Queue a servo's answer with `data`, sent after its return delay; faults lose or spoil it.

        after_s: when the return delay begins. byte_s: seconds per byte. servo_id: the id in the
        answer; None: as in the register. Answers that overlap on the wire damage each other.
        """
        raw = packet(servo["id"] if servo_id is None else servo_id, servo.table[65], data)
        start_s = after_s + servo["return_delay_time"] * RETURN_DELAY_UNIT_S
        end_s = start_s + len(raw) * byte_s
        self._wire_until_s = max(self._wire_until_s, end_s)
        if start_s < self._until_s["lost"]:
            return
        if start_s < self._until_s["spoilt"]:
            at = self._rng.randrange(len(raw))
            raw = raw[:at] + bytes((raw[at] ^ 1 << self._rng.randrange(8),)) + raw[at + 1 :]
        for other in self._replies:
            if other.start_s < end_s - 1e-9 and start_s < other.end_s - 1e-9:
                self.n_spoken_over += 1
                # Two transmitters are never in step: bits are lost even where both say the same.
                other.data = other.data[:-1] + bytes((other.data[-1] ^ 0xFF,))
                raw = b""
        if raw:
            self._replies.append(_Reply(start_s, end_s, raw))

    def _log(self, servo: SimulatedServo) -> None:
        now = servo.table[TORQUE_ENABLE], servo["goal_position"]
        if self._logged.get(servo.index) != now:
            self._logged[servo.index] = now
            change = ServoChange(self._now_s, servo["id"], *now, servo.place)
            self.changes.append(change)
            self._on_change(change)


def chain_for(servos: Sequence[MountedServo], baud_rate: int, **options: Any) -> SimulatedChain:
    """Return a simulated chain of a face's servos with their ids, rate and limits, limp in neutral.

    options: keyword arguments of `SimulatedChain`.
    """
    ids = [servo.joint.servo_id for servo in servos]
    chain = SimulatedChain([servo.model for servo in servos], ids, **options)
    for servo, simulated in zip(servos, chain.servos, strict=True):
        held = {"phase": simulated["phase"]}
        for name, value in wanted_settings(servo, baud_rate, held).items():
            simulated[name] = value
        simulated.stand_at(servo.pulse(0.0))
    return chain


def simulated_wire(wiring: Wiring) -> tuple[FeetechBus, ManualClock]:
    """Return a bus of the face's servos simulated in memory, and the clock that drives them."""
    servos, clock, rate = mounted_servos(wiring), ManualClock(), wiring.settings.baud_rate
    chain = chain_for(servos, rate)
    return FeetechBus(servos, lambda: MemoryTransport(chain, clock, rate)), clock


def serve(wiring: Wiring | None, link: Path | None, request: SimulationRequest) -> PtyHost:
    """Return a host that serves simulated servos at a pseudo-terminal.

    wiring: the servos of the face that is simulated; None: new servos of one model, with factory
    settings. link: path of a symbolic link to the terminal. request.log: a file that gets each
    change of torque or goal as a line of JSON. Raises ServoError for an unknown model, baud rate or
    id and for a log that cannot be written, ValueError for an invalid script, and PortError where
    no terminal or link can be made.
    """
    rates, last_id = baud_rates(), BROADCAST_ID - 1
    new = request.new_servos(servo_models(), "STS3215", rates.values(), last_id)
    write = request.row_log()

    def on_change(now: ServoChange) -> None:
        write((round(now.time_s, 6), now.servo_id, now.torque, now.goal, now.place))

    options: dict[str, Any] = {"faults": request.timed_faults(ChainFault), "on_change": on_change}
    if wiring is not None:
        rate = request.baud_rate or wiring.settings.baud_rate
        return PtyHost(chain_for(mounted_servos(wiring), rate, **options), link)
    chain = SimulatedChain(*new, **options)
    code = next(code for code, rate in rates.items() if rate == (request.baud_rate or 1_000_000))
    for servo in chain.servos:
        servo["baud_rate"] = code
    return PtyHost(chain, link)
