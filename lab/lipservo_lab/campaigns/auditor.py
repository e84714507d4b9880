"""An auditor that watches a simulated face from outside: every packet on the bus, every shaft.

It knows the face's limits, uses nothing of the code under test, and trusts none of it.
"""

import struct
from collections.abc import Iterator, Sequence
from typing import Any, Final, Literal, NamedTuple, Protocol

import numpy as np

from firmware_bridge.bus import Array
from firmware_bridge.dynamixel.control_table import register
from firmware_bridge.dynamixel.wire.codec import BROADCAST_ID, FrameParser, Instruction
from firmware_bridge.feetech import codec as feetech_codec
from firmware_bridge.feetech.control_table import TORQUE_ENABLE
from firmware_bridge.feetech.control_table import servo_models as feetech_models
from firmware_bridge.serial_servos.mounting import MountedServo
from firmware_bridge.simulator.motors import POSITION_LOOP_PER_S
from firmware_bridge.stopping import StopLevel

_GOAL, _TORQUE = register("goal_position").address, register("torque_enable").address
_GOAL_BYTES, _TORQUE_BYTES = struct.pack("<H", _GOAL), struct.pack("<H", _TORQUE)
_FEETECH_GOAL: Final = feetech_models()["STS3215"].dialect.registers["goal_position"].address
#: A goal is rounded to a pulse, and so was the one before it.
_ROUNDING_PULSES: Final = 1
#: A goal this near to a shaft counts as its position: half a degree, as a limp shaft may be moving.
_PLACE_PULSES: Final = 6
#: A shaft may be a degree outside its limits (sag, rounding) before moving further out counts.
_MARGIN_PULSES: Final = 12
#: Speeds above the promised top speed times this count.
_SPEED_MARGIN: Final = 1.10
#: Time in which a frozen face may still brake, and the speed at which it may give way under load.
_BRAKES_S, _CREEP_DEG_S = 0.3, 5.0
#: A shaft this near to its unhindered position is unhindered.
_FREE_PULSES: Final = 0.5
#: No motor turns so fast: the encoder jumped.
_JUMP_DEG_S: Final = 700.0


class SeenOrder(NamedTuple):
    """An order of the computer to one servo.

    what: "goal" in a tick, "first goal" to this servo alone, or "torque" on. goal: in pulses.
    """

    what: Literal["goal", "first goal", "torque"]
    servo_id: int
    goal: int = 0


class AuditedWire(Protocol):
    """A bus protocol: what its packets order, and when a servo may be armed.

    has_watchdog: whether servos stop by themselves when the computer falls silent.
    """

    has_watchdog: bool

    def orders(self, data: bytes) -> Iterator[SeenOrder]:
        """Parse the orders in one write of the computer."""

    def is_set_up(self, servo: Any, wanted: MountedServo[Any]) -> bool:
        """Return whether a simulated servo has all settings that it must have before torque."""


class DynamixelWire:
    """Dynamixel protocol 2.0."""

    has_watchdog = True

    def __init__(self) -> None:
        self._parser = FrameParser()

    def orders(self, data: bytes) -> Iterator[SeenOrder]:
        """Parse the orders in one write of the master."""
        if _GOAL_BYTES not in data and _TORQUE_BYTES not in data and not self._parser.pending:
            return  # the address is in no packet of it
        for frame in self._parser.feed(data):
            parameters = frame.parameters
            if frame.instruction == Instruction.WRITE and frame.packet_id != BROADCAST_ID:
                if parameters[:2] == _GOAL_BYTES:
                    goal = int.from_bytes(parameters[2:6], "little", signed=True)
                    yield SeenOrder("first goal", frame.packet_id, goal)
                elif parameters[:3] == _TORQUE_BYTES + b"\1":
                    yield SeenOrder("torque", frame.packet_id)
            elif frame.instruction == Instruction.SYNC_WRITE and parameters[:2] == _GOAL_BYTES:
                for servo_id, goal in struct.iter_unpack("<Bi", parameters[4:]):
                    yield SeenOrder("goal", servo_id, goal)

    def is_set_up(self, servo: Any, wanted: MountedServo[Any]) -> bool:
        """Return whether a servo's settings are the face's, and its watchdog runs."""
        low, high = wanted.pulse_range()
        return bool(
            servo["drive_mode"] == 0
            and servo["homing_offset"] == 0
            and servo["operating_mode"] == (3 if wanted.current_cap is None else 5)
            and servo["min_position_limit"] <= low <= high <= servo["max_position_limit"]
            and servo["bus_watchdog"] > 0
        )


class FeetechWire:
    """Feetech's protocol, STS: little-endian, one sync write of goals with speeds a tick."""

    has_watchdog = False

    def orders(self, data: bytes) -> Iterator[SeenOrder]:
        """Parse the orders in one write of the computer, which is of whole packets."""
        for packet in feetech_codec.statuses_in(data):
            servo_id, instruction, parameters = packet
            if instruction == feetech_codec.Instruction.WRITE and parameters[0] == _FEETECH_GOAL:
                yield SeenOrder("first goal", servo_id, int.from_bytes(parameters[1:3], "little"))
            elif instruction == feetech_codec.Instruction.SYNC_WRITE:
                address, size, blocks = parameters[0], parameters[1], parameters[2:]
                for start in range(0, len(blocks), size + 1):
                    value = int.from_bytes(blocks[start + 1 : start + 1 + min(size, 2)], "little")
                    if address == _FEETECH_GOAL:
                        yield SeenOrder("goal", blocks[start], value)
                    elif address == TORQUE_ENABLE and value == 1:
                        yield SeenOrder("torque", blocks[start])

    def is_set_up(self, servo: Any, wanted: MountedServo[Any]) -> bool:
        """Return whether a servo's limits are the face's, and its speed is bounded."""
        low, high = wanted.pulse_range()
        in_order = servo["min_position_limit"] <= low <= high <= servo["max_position_limit"]
        return bool(in_order and servo["operating_mode"] == 0 and servo["goal_speed"] > 0)


class Auditor:
    """Counts events that must not happen, each on one servo.

    goals: goals seen. goals_outside: goals beyond the joint's limits that do not lead back; when
    torque comes on, any goal but the position. steps_too_long: goals farther from the last than top
    speed allows in one period. too_fast: simulator steps faster than 1.1 times top speed with
    torque on, except of a shaft that was pushed or held up, until it is back on its trajectory.
    moved_outside: steps outwards beyond the limits with torque on. armed_wrongly: torque switched
    on with settings that differ from the face's, without a running watchdog, or with a goal
    elsewhere. armed_late: torque switched on after a person's stop. moved_frozen: steps faster than
    5 deg/s, later than 0.3 s after a person froze the face.
    """

    def __init__(
        self, servos: Sequence[MountedServo[Any]], period_s: float, wire: AuditedWire | None = None
    ) -> None:
        """Prepare to count breaches of the safety rules that the class lists.

        servos: those to watch, on the bus and by their shafts. wire: how to read their packets;
        None: as Dynamixels'. period_s: of the servo loop.
        """
        # All positions are in pulses, all speeds in pulses per second.
        ranges = np.array([servo.pulse_range() for servo in servos], dtype=np.float64)
        self._servos = {servo.joint.servo_id: servo for servo in servos}
        self._low, self._high = ranges[:, 0], ranges[:, 1]
        per_deg = np.array([servo.model.pulses_per_deg for servo in servos])
        self._speed = np.array([s.joint.max_speed_deg_s for s in servos]) * per_deg
        self._reach = {
            servo.joint.servo_id: speed * period_s + _ROUNDING_PULSES
            for servo, speed in zip(servos, self._speed.tolist(), strict=True)
        }
        self._jump = _JUMP_DEG_S * per_deg
        #: Where each shaft would be if nothing hindered it: behind its trajectory only by its
        #: position loop's lag. A shaft elsewhere was pushed, jammed or loaded; its servo brings it
        #: back as fast as it can, without being commanded.
        self._free = np.zeros(len(servos))
        self._is_free = np.zeros(len(servos), dtype=np.bool_)
        self._last: dict[int, int] = {}
        self._wire = wire or DynamixelWire()
        self._chain: Any = None
        self._before: tuple[Array, Array] | None = None
        self._held = np.zeros(len(servos), dtype=np.bool_)  # torque was on at the step before
        self._before_s = 0.0
        self._creep = _CREEP_DEG_S * per_deg
        self._stopped_s: float | None = None
        self._frozen = False
        self.moved_frozen = 0
        self.goals = self.goals_outside = self.steps_too_long = 0
        self.too_fast = self.moved_outside = self.armed_wrongly = self.armed_late = 0
        self.fastest = 0.0

    def watch(self, chain: Any) -> None:
        """Follow the shafts of this simulated chain; check its servos when torque comes on."""
        self._chain = chain
        chain.motors.motion = self._see_motion

    def note_stop(self, time_s: float, level: StopLevel) -> None:
        """Note a person's stop; after a freeze no shaft may move until `let_go`."""
        self._stopped_s = time_s
        self._frozen = level is StopLevel.FREEZE

    def let_go(self) -> None:
        """Note that a frozen face is released now, and may move."""
        self._frozen = False

    def see(self, time_s: float, data: bytes) -> None:
        """Inspect one write of the computer."""
        for what, servo_id, goal in self._wire.orders(data):
            if what == "goal":
                self._see_goal(servo_id, goal)
            elif what == "first goal":
                self._see_first_goal(servo_id, goal)
            else:
                self._see_torque(servo_id, time_s)

    def _see_goal(self, servo_id: int, goal: int) -> None:
        """Count a goal (pulses), and whether it is out of range or too far from the last."""
        self.goals += 1
        low, high = self._servos[servo_id].pulse_range()
        before = self._last.get(servo_id, goal)
        self._last[servo_id] = goal
        # A joint found outside its limits is brought back in.
        if not min(low, before) - 1 <= goal <= max(high, before) + 1:
            self.goals_outside += 1
        too_long = abs(goal - before) > self._reach[servo_id] + 1e-6
        if too_long and not self._is_way_back(servo_id, before, goal):
            self.steps_too_long += 1

    def _see_first_goal(self, servo_id: int, goal: int) -> None:
        """Count the goal (pulses) before torque, which must be the position of the servo."""
        self._last[servo_id] = goal
        self.goals += 1
        if not self._is_place(servo_id, goal):
            self.goals_outside += 1

    def _is_way_back(self, servo_id: int, before: int, goal: int) -> bool:
        """Return whether the new goal lies between the old one and the position of the servo."""
        index = self._index(servo_id)
        if index is None or self._chain is None:
            return False
        place = float(self._chain.motors.position[index])
        return min(before, place) - _PLACE_PULSES <= goal <= max(before, place) + _PLACE_PULSES

    def _is_place(self, servo_id: int, goal: int) -> bool:
        """Return whether `goal` is the position of the servo, so that it does not move.

        True if no simulated servo, or more than one, has this id.
        """
        index = self._index(servo_id)
        if index is None or self._chain is None:
            return True
        return bool(abs(goal - self._chain.motors.position[index]) <= _PLACE_PULSES)

    def _see_torque(self, servo_id: int, time_s: float) -> None:
        """Count torque that comes on after a person's stop, or wrongly.

        Wrongly: with settings that differ from the face's, or with a goal off the position.
        """
        if self._stopped_s is not None and time_s > self._stopped_s:
            self.armed_late += 1
        index = self._index(servo_id)
        if index is None or self._chain is None:
            return
        servo, mounted = self._chain.servos[index], self._servos[servo_id]
        place = self._chain.motors.position[index]
        at_place = abs(servo["goal_position"] - place) <= _PLACE_PULSES
        self.armed_wrongly += not (at_place and self._wire.is_set_up(servo, mounted))

    def _see_motion(self, time_s: float, position: Array) -> None:
        """Count forbidden motion of all shafts; the simulator calls this at each of its steps.

        position: (n_servos,) pulses. The motion of a servo's trajectory always counts; that of its
        shaft only while torque is on and nothing has pushed it or held it up.
        """
        assert self._chain is not None  # it calls
        motors = self._chain.motors
        if self._frozen and not (self._wire.has_watchdog or self._chain.plugged):
            self._stopped_s = time_s  # unplugged servos without watchdog go on to their goal
        last, self._before = self._before, (position.copy(), motors.trajectory.copy())
        held, self._held = self._held & motors.torque_on, motors.torque_on.copy()
        span_s, self._before_s = time_s - self._before_s, time_s
        if last is None or span_s <= 0.0:
            return
        before, trajectory_before = last
        speed = (position - before) / span_s
        commanded = np.abs(motors.trajectory - trajectory_before) / span_s
        # The trajectory follows a jump of the encoder; and a servo that stops by itself, as by its
        # watchdog, sets it to its position. Neither was commanded.
        jumped = (np.abs(speed) >= self._jump) & (commanded >= self._jump)
        by_itself = ~held | jumped | (motors.trajectory == position)
        commanded[by_itself] = 0.0
        self._free += (motors.trajectory - self._free) * min(1.0, POSITION_LOOP_PER_S * span_s)
        self._free = np.where(by_itself, position, self._free)
        was_free, self._is_free = self._is_free, np.abs(position - self._free) <= _FREE_PULSES
        unhindered = held & was_free & self._is_free
        moved = np.maximum(np.where(unhindered, np.abs(speed), 0.0), commanded)
        fast = moved / self._speed
        self.fastest = max(self.fastest, float(fast.max()))
        self.too_fast += int((fast > _SPEED_MARGIN).sum())
        if self._frozen and self._stopped_s is not None and time_s > self._stopped_s + _BRAKES_S:
            self.moved_frozen += int((moved > self._creep).sum())
        outwards = (position > self._high + _MARGIN_PULSES) & (speed > 1.0)
        outwards |= (position < self._low - _MARGIN_PULSES) & (speed < -1.0)
        self.moved_outside += int((unhindered & outwards).sum())

    def _index(self, servo_id: int) -> int | None:
        """Return the index of the simulated servo that has this id now; None: none, or several."""
        if self._chain is None:
            return None
        found = [s.index for s in self._chain.servos if s["id"] == servo_id]
        return found[0] if len(found) == 1 else None
