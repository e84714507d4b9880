"""A face full of Dynamixel servos as one `ServoBus`."""

import struct
from collections.abc import Callable, Sequence
from typing import Any, Final, Self

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.bus import PortError, PortGone, Readings
from firmware_bridge.dynamixel import codec
from firmware_bridge.dynamixel.codec import Status, StatusError
from firmware_bridge.dynamixel.control_table import register
from firmware_bridge.dynamixel.group import SpanGroup
from firmware_bridge.dynamixel.handshake import introduce_all
from firmware_bridge.dynamixel.knowledge import Knowledge
from firmware_bridge.dynamixel.line import FACTORY_RETURN_DELAY_S, GoalWrite, Line
from firmware_bridge.dynamixel.mounting import MountedServo, Mounting
from firmware_bridge.dynamixel.soft_start import SoftStart
from firmware_bridge.dynamixel.transport import Transport
from firmware_bridge.dynamixel.watchdog import Watchdogs
from firmware_bridge.health import Feedback, Health

_TORQUE, _GOAL = register("torque_enable").address, register("goal_position").address
_LEVEL = register("status_return_level").address
#: torque_enable .. bus_watchdog, and what lies between: health in one read.
_HEALTH_SIZE: Final = register("bus_watchdog").end - _TORQUE
_ERROR_AT: Final = register("hardware_error_status").address - _TORQUE
_WARMTH = register("present_input_voltage").address
_PRESENT = register("present_current").address
#: goal_position .. present_position
_MOTION_SIZE: Final = register("present_position").end - _GOAL
#: Torque off is said this often before it is checked: a lost packet must not keep a face stiff.
_LIMP_REPEATS: Final = 3
#: Torque comes on one servo after another: twenty at once make the supply sag.
_STAGGER_S: Final = 0.010


class DynamixelBus:
    """Servos on one line, found by their ids, spoken to in joint degrees.

    A servo that falls silent costs its own samples only. When the port fails every method raises
    PortGone until `reopen` succeeds. Never writes EEPROM.
    """

    def __init__(
        self,
        servos: Sequence[MountedServo],
        open_transport: Callable[[], Transport],
        *,
        watchdog_s: float = 0.1,
        strict: bool = True,
        make_line: Callable[[Any], Line] = Line,
    ) -> None:
        """watchdog_s: how long servos go on without hearing anything; 0 = for ever.

        strict: every servo must answer before the first goal; else one critical or none at all
        missing is enough to go on. make_line: `SdkLine` leaves the packets to dynamixel-sdk.
        """
        self._make_line = make_line
        self._servos = tuple(servos)
        self._ids = [servo.joint.servo_id for servo in servos]
        self._index = {servo_id: n for n, servo_id in enumerate(self._ids)}
        self._open_transport = open_transport
        self._watchdogs = Watchdogs(self._ids, watchdog_s)
        self._strict = strict
        self._mounting = Mounting(servos)
        self._known = Knowledge(servos)
        self._soft_start = SoftStart(servos)
        self._goal_write = GoalWrite(self._ids, _GOAL)
        self._motion = SpanGroup(self._ids, _PRESENT, 10)
        self._whole = SpanGroup(self._ids, _GOAL, _MOTION_SIZE)
        self._holding = SpanGroup(self._ids, _TORQUE, 1)
        self._turn = 0
        self._line: Line | None = None

    @property
    def at_full_strength(self) -> bool:
        """Whether every servo with torque on has been told its full speed and current."""
        return not self._soft_start.soft

    @property
    def line(self) -> Line:
        """The open line. Raises PortError when there is none."""
        if self._line is None:
            raise PortError("the bus is used outside its `with` block, or its port is gone")
        return self._line

    def set_torque(self, on: bool) -> None:
        """On: everybody, one after another, soft at first. Off: three times, then checked."""
        if on:
            for n in range(len(self._ids)):
                self._switch_on(n)
            return
        line = self.line
        self._soft_start.forget()
        request = codec.sync_write(_TORQUE, 1, [(each, b"\0") for each in self._ids])
        for _ in range(_LIMP_REPEATS):
            line.tell(request)
        for _ in range(_LIMP_REPEATS):
            self._note(self._holding.ask(line))
            for status in self._holding.answers:
                self._known.torque[self._index[status.servo_id]] = status.data != b"\0"
            if not self._known.torque.any():
                return
            line.tell(request)

    def write_positions(self, positions_deg: NDArray[np.float64]) -> None:
        """Every goal inside its servo's range; NaN is not, nor is what the servo would refuse."""
        if positions_deg.shape != self._known.goals.shape:
            raise ValueError(
                f"expected positions of shape {self._known.goals.shape}, got {positions_deg.shape}"
            )
        line = self.line
        self._watchdogs.keep(line)
        pulses = self._mounting.pulses(positions_deg)
        taken = (self._known.low <= pulses) & (pulses <= self._known.high)
        self._known.errors = np.where(taken, 0, StatusError.DATA_LIMIT).astype(np.uint8)
        self._known.goals = np.where(taken, pulses, self._known.goals)
        if taken.all():
            line.tell(self._goal_write.request(pulses.astype(np.int64).tolist()))
        elif taken.any():
            blocks = [
                (self._ids[n], struct.pack("<i", int(pulses[n]))) for n in np.flatnonzero(taken)
            ]
            line.tell(codec.sync_write(_GOAL, 4, blocks))

    def read(self) -> Readings:
        """Two questions to all: goals and places, then torque."""
        line = self.line
        found = self._note(self._whole.ask(line))
        for status in found:
            n = self._index[status.servo_id]
            goal, place = struct.unpack_from("<i12xi", status.data)
            self._known.goals[n], self._known.pulses[n] = goal, place
        held = self._holding.ask(line)
        for status in held:
            self._known.torque[self._index[status.servo_id]] = status.data != b"\0"
        now_s = line.transport.clock.now()
        ages_s = self._known.ages(found, now_s)
        # A goal counts as read only when it was: whoever arms relies on it.
        goals = np.where(ages_s > 0.0, np.nan, self._known.goals)
        return Readings(
            time_s=now_s,
            positions_deg=self._mounting.joint_deg(self._known.pulses),
            goals_deg=self._mounting.joint_deg(goals),
            torque_on=self._known.torque.copy(),
            errors=self._known.errors.copy(),
            age_s=ages_s,
        )

    def feedback(self) -> Feedback:
        """One question to all; of a silent servo the last answer, with its age."""
        line = self.line
        found = self._note(self._motion.ask(line))
        self._known.take_motion(found)
        now_s = line.transport.clock.now()
        return Feedback(
            time_s=now_s,
            positions_deg=self._mounting.joint_deg(self._known.pulses),
            effort=self._known.effort.copy(),
            errors=self._known.errors.copy(),
            age_s=self._known.ages(found, now_s),
        )

    def look_after(self) -> Health:
        """Torque, errors and watchdog of one servo, or its warmth and voltage, in turns."""
        line = self.line
        turn, kind = divmod(self._turn, 2)
        self._turn = (self._turn + 1) % (2 * len(self._ids))
        servo_id = self._ids[turn]
        if kind == 0:
            status = line.read(servo_id, _TORQUE, _HEALTH_SIZE)
            if status is not None and len(status.data) == _HEALTH_SIZE:
                self._known.torque[turn] = status.data[0] == 1
                self._known.hardware[turn] = status.data[_ERROR_AT]
                self._known.tripped[turn] = status.data[-1] == 0xFF
        else:
            status = line.read(servo_id, _WARMTH, 3)
            if status is not None and len(status.data) == 3:
                self._known.voltage_v[turn] = int.from_bytes(status.data[:2], "little") / 10.0
                self._known.room_degc[turn] = self._known.hottest[turn] - status.data[2]
        if status is not None:
            self._note([status])
            for group in (self._motion, self._whole, self._holding):
                group.trust(servo_id)
        self._soft_start.harden(line)
        return self._known.health(line.transport.clock.now())

    def wake(self, index: int) -> bool:
        """Goal := place, checked, then slow profile, watchdog, torque."""
        line, servo_id = self.line, self._ids[index]
        line.write(servo_id, _LEVEL, b"\2")
        self._watchdogs.clear(line, servo_id)
        status = line.read(servo_id, _GOAL, _MOTION_SIZE)
        if status is None or len(status.data) != _MOTION_SIZE:
            return False
        _, place = struct.unpack_from("<i12xi", status.data)
        if not self._known.low[index] <= place <= self._known.high[index]:
            return False
        line.write(servo_id, _GOAL, struct.pack("<i", place))
        check = line.read(servo_id, _GOAL, 4)
        if check is None or check.data != struct.pack("<i", place):
            return False
        self._known.goals[index] = self._known.pulses[index] = place
        return self._switch_on(index)

    def relax(self, index: int) -> None:
        """Torque off, acknowledged if possible."""
        line, servo_id = self.line, self._ids[index]
        for _ in range(_LIMP_REPEATS):
            if line.write(servo_id, _TORQUE, b"\0") is not None:
                self._known.torque[index] = False
                return

    def reboot(self, index: int) -> None:
        """Restart one servo and forget what was known of it."""
        self.line.reboot(self._ids[index])
        self._known.hardware[index] = 0
        self._known.torque[index] = self._known.tripped[index] = False

    def reopen(self) -> None:
        """A new handle, and everybody introduced again. Raises PortError, ServoError."""
        self._close()
        self._open(strict=False)

    def __enter__(self) -> Self:
        self._open(strict=self._strict)
        return self

    def __exit__(self, *exc: object) -> None:
        try:
            if self._line is not None:
                self.set_torque(False)
        except PortGone:
            pass  # nobody to tell; the servos' own watchdog stops them
        finally:
            self._close()

    def _open(self, *, strict: bool) -> None:
        transport = self._open_transport()
        line = self._make_line(transport)
        try:
            said = introduce_all(line, self._servos, strict=strict)
        except BaseException:
            transport.close()
            raise
        delays = [answer.return_delay_s for answer in said if answer is not None]
        unsure = any(answer is None for answer in said)
        line.return_delay_s = max([*delays, FACTORY_RETURN_DELAY_S if unsure else 0.0])
        for n, answer in enumerate(said):
            if answer is not None:
                self._known.low[n] = answer.eeprom["min_position_limit"]
                self._known.high[n] = answer.eeprom["max_position_limit"]
                self._known.hottest[n] = answer.eeprom["temperature_limit"]
                self._known.heard_s[n] = transport.clock.now()
        self._line = line
        line.tell(codec.sync_write(_LEVEL, 1, [(each, b"\2") for each in self._ids]))
        for group in (self._motion, self._whole, self._holding):
            group.reset()

    def _close(self) -> None:
        if self._line is not None:
            self._line.transport.close()
            self._line = None

    def _switch_on(self, index: int) -> bool:
        """Soft settings, watchdog, torque of one servo; whether it says that it holds."""
        line, servo_id = self.line, self._ids[index]
        clock = line.transport.clock
        self._known.tripped[index] = False
        self._soft_start.soften(line, index)
        self._watchdogs.arm(line, servo_id)
        for _ in range(_LIMP_REPEATS):
            status = line.write(servo_id, _TORQUE, b"\1")
            if status is not None:
                self._known.torque[index] = not status.error & 0x7F
                self._soft_start.began(index, clock.now())
                break
        now_s = clock.now()
        self._watchdogs.spoke(now_s)
        clock.sleep_until(now_s + _STAGGER_S)
        return bool(self._known.torque[index])

    def _note(self, statuses: list[Status]) -> list[Status]:
        """Remember who answered, and with what error."""
        now_s = self.line.transport.clock.now()
        self._watchdogs.spoke(now_s)
        self._known.note(statuses, now_s)
        return statuses
