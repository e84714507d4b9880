"""Torque of single servos: on without a jump or jerk, off until a read confirms it; watchdogs."""

import struct
from collections.abc import Collection, Sequence
from typing import Final

import numpy as np

from firmware_bridge.bus import any_set
from firmware_bridge.capabilities import SOFT_START_S
from firmware_bridge.dynamixel.control_table import VELOCITY_UNIT_DEG_S, WATCHDOG_UNIT_S, register
from firmware_bridge.dynamixel.mounting import MountedServo, ServoIdentity, identify, mismatches
from firmware_bridge.dynamixel.present_state import PresentState
from firmware_bridge.dynamixel.wire import codec
from firmware_bridge.dynamixel.wire.codec import BROADCAST_ID, MAX_ID
from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.serial_servos.mounting import Mounting
from firmware_bridge.serial_servos.torque import (
    SOFT_DEG_S,
    SOFT_STRENGTH,
    SPEED_MARGIN,
    TRIES,
    SerialRelease,
    SerialTorqueSwitch,
    write_verified,
)

_ADDRESS: Final = register("bus_watchdog").address
_LONGEST: Final = 127


class Watchdogs:
    """The servos' bus watchdogs, and whether a pause of our own packets may have tripped them."""

    def __init__(self, ids: Sequence[int], timeout_s: float) -> None:
        """Set for how long servos go on without receiving a packet: `timeout_s`; 0 = for ever."""
        self._ids = tuple(ids)
        #: The value that register `bus_watchdog` must have while torque is on; 0 = no watchdog.
        self.setting = min(_LONGEST, int(np.ceil(timeout_s / WATCHDOG_UNIT_S - 1e-9)))
        self._trips_after_s = self.setting * WATCHDOG_UNIT_S if self.setting else float("inf")
        self._spoke_s = 0.0
        self._lapsed = False

    def start(self, line: Line, servo_id: int) -> bool:
        """Clear and start one servo's watchdog; return whether a read shows the new setting.

        A tripped watchdog accepts no goals until it is cleared, and a lost write would leave
        nothing to stop a face whose computer has died.
        """
        cleared = write_verified(line, servo_id, _ADDRESS, b"\0")
        if not (cleared and self.setting):
            return cleared
        return write_verified(line, servo_id, _ADDRESS, bytes((self.setting,)))

    def spoke(self, now_s: float) -> None:
        """Note a packet sent at `now_s`, and whether the pause before may have tripped watchdogs.

        `keep` restarts the watchdogs after such a pause.
        """
        if now_s - self._spoke_s >= self._trips_after_s:
            self._lapsed = True
        self._spoke_s = now_s

    def keep(self, line: Line) -> None:
        """Restart all watchdogs if a pause may have tripped them; to call before every goal."""
        self.spoke(line.transport.clock.now())
        if self._lapsed:
            self._lapsed = False
            for value in (b"\0", bytes((self.setting,))):
                line.tell(codec.sync_write(_ADDRESS, 1, [(each, value) for each in self._ids]))


_PROFILE: Final = register("profile_acceleration").address
_CURRENT: Final = register("goal_current").address
#: No servo acknowledges a sync write: full strength is sent this often, this far apart.
_REPEATS: Final = 3
_REPEAT_S: Final = 0.1


class SoftStart:
    """Tracks which servos are limited in speed and current after torque on, and for how long."""

    def __init__(self, servos: Sequence[MountedServo]) -> None:
        self._servos = tuple(servos)
        self._due_s = np.full(len(servos), np.inf)
        self._n_left = np.zeros(len(servos), dtype=np.int8)

    @property
    def is_active(self) -> bool:
        """Whether any servo has yet to be set to its full strength."""
        return bool(self._n_left.any())

    def apply_soft_limits(self, line: Line, index: int) -> bool:
        """Limit a servo's speed and, with max_current_ma, current; return whether reads confirm it.

        To be called before torque comes on.
        """
        servo = self._servos[index]
        servo_id, cap = servo.joint.servo_id, servo.current_cap
        slow_deg_s = min(SOFT_DEG_S, servo.joint.max_speed_deg_s)
        wanted = [(_PROFILE, struct.pack("<II", 0, _velocity(slow_deg_s)))]
        if cap is not None:
            weak = max(1, round(cap * SOFT_STRENGTH))
            wanted.append((_CURRENT, struct.pack("<h", weak)))
        return all(write_verified(line, servo_id, *each) for each in wanted)

    def note_torque_on(self, index: int, now_s: float) -> None:
        """Begin the soft start of a servo whose torque was switched on at `now_s`."""
        self._due_s[index] = now_s + SOFT_START_S
        self._n_left[index] = _REPEATS

    def cancel(self) -> None:
        """End all soft starts, since torque is off everywhere."""
        self._due_s[:] = np.inf
        self._n_left[:] = 0

    def restore_full_limits(self, line: Line) -> None:
        """Set servos to full speed and current a second after torque on; to call in every tick.

        Sent three times, .1 s apart, since no servo acknowledges the packet.
        """
        if not any_set(self._n_left):
            return
        now_s = line.transport.clock.now()
        due = np.flatnonzero(self._due_s <= now_s).tolist()
        if not due:
            return
        servos = [self._servos[n] for n in due]
        profiles = [(each.joint.servo_id, _full_profile(each)) for each in servos]
        line.tell(codec.sync_write(_PROFILE, 8, profiles))
        caps = [(s.joint.servo_id, s.current_cap) for s in servos]
        currents = [(each, struct.pack("<h", cap)) for each, cap in caps if cap is not None]
        if currents:
            line.tell(codec.sync_write(_CURRENT, 2, currents))
        self._n_left[due] -= 1
        self._due_s[due] = np.where(self._n_left[due] > 0, now_s + _REPEAT_S, np.inf)


def _full_profile(servo: MountedServo) -> bytes:
    return struct.pack("<II", 0, _velocity(servo.joint.max_speed_deg_s * SPEED_MARGIN))


def _velocity(deg_s: float) -> int:
    """Return a speed in units of the profile velocity register, at least 1: 0 is unlimited."""
    return max(1, min(32_767, round(deg_s / VELOCITY_UNIT_DEG_S)))


_TORQUE, _GOAL = register("torque_enable").address, register("goal_position").address
_PLACE, _LEVEL = register("present_position").address, register("status_return_level").address


class TorqueSwitch(SerialTorqueSwitch[Line]):
    """Switches torque of one Dynamixel at a time. Every method may raise PortError."""

    torque_address = _TORQUE
    identify, mismatches = staticmethod(identify), staticmethod(mismatches)

    def __init__(
        self,
        servos: Sequence[MountedServo],
        present: PresentState,
        mounting: Mounting,
        soft_start: SoftStart,
        watchdogs: Watchdogs,
    ) -> None:
        """Switch torque of `servos`, with the bus's own objects for state, limits and watchdogs."""
        super().__init__(servos, present, mounting)
        self._soft_start = soft_start
        self._watchdogs = watchdogs

    @property
    def at_full_strength(self) -> bool:
        """Whether every servo with torque on has been set to its full speed and current."""
        return not self._soft_start.is_active

    def cancel(self) -> None:
        """End all soft starts, since torque goes off everywhere; sends nothing."""
        self._soft_start.cancel()

    def renew_watchdog(self, line: Line, index: int, found: int) -> None:
        """Restart a servo's watchdog if it is off although torque is on, so that it protects again.

        found: the value read from register `bus_watchdog`.
        """
        tripped, wanted = 0xFF, self._watchdogs.setting
        if self._cache.enabled[index] and found not in (wanted, tripped):
            self._watchdogs.start(line, self._servos[index].joint.servo_id)

    def _prepare(self, line: Line, index: int, place: int) -> str:
        """Start the watchdog, set goal and soft limits before torque on; return what is refused.

        place: present position in encoder steps, which becomes the goal. "": reads confirmed all.
        """
        cache, servo_id = self._cache, self._servos[index].joint.servo_id
        # First of all, since a tripped watchdog refuses every goal.
        if not self._watchdogs.start(line, servo_id):
            return "does not take its bus watchdog"
        if not write_verified(line, servo_id, _GOAL, struct.pack("<i", place)):
            return "does not take the place where it stands as its goal"
        cache.pulses[index] = place
        cache.set_one("tripped", index, False)
        taken = self._soft_start.apply_soft_limits(line, index)
        return "" if taken else "does not take its slow start"

    def _begin_soft_start(self, index: int, now_s: float) -> None:
        self._soft_start.note_torque_on(index, now_s)
        self._watchdogs.spoke(now_s)

    def _hold(self, line: Line, index: int) -> bool:
        """Restart the watchdog and make the present position the goal; return whether confirmed."""
        cache, servo_id = self._cache, self._servos[index].joint.servo_id
        cache.enabled[index] = True
        place = self._place_now(line, servo_id)
        if place is None or not self._watchdogs.start(line, servo_id):
            return False
        cache.pulses[index] = place
        cache.set_one("tripped", index, False)
        return write_verified(line, servo_id, _GOAL, struct.pack("<i", place))

    def _set_torque(self, line: Line, servo_id: int, *, on: bool) -> bool:
        return write_verified(line, servo_id, _TORQUE, b"\1" if on else b"\0")

    def _place(self, line: Line, servo_id: int, _found: ServoIdentity) -> int | None:
        line.write(servo_id, _LEVEL, b"\2")
        return self._place_now(line, servo_id)

    def _place_now(self, line: Line, servo_id: int) -> int | None:
        for _ in range(TRIES):
            status = line.read(servo_id, _PLACE, 4)
            if status is not None and len(status.data) == 4:
                return int.from_bytes(status.data, "little", signed=True)
        return None


#: A packet that no servo answers is sent this often.
_REPEATS_BY_FORCE: Final = 3


class LineRelease(SerialRelease[Line]):
    """Torque off at an open port, for Dynamixels that another process drove before."""

    make_line = Line
    torque_address = _TORQUE

    def tell_all(self, addresses: Sequence[int]) -> None:
        """Send torque off to `addresses` and to all others, several times; read no answer.

        Tripped watchdogs are cleared before the last torque off. Servos that were set not to answer
        are set to answer every instruction.
        """
        line = self._line
        everybody = codec.write(BROADCAST_ID, _TORQUE, b"\0")
        blocks = [(each, b"\0") for each in addresses]
        listed = codec.sync_write(_TORQUE, 1, blocks) if blocks else everybody
        for _ in range(_REPEATS_BY_FORCE):
            line.tell(listed)
        line.tell(codec.write(BROADCAST_ID, _ADDRESS, b"\0"))
        line.tell(everybody)
        line.tell(codec.write(BROADCAST_ID, _LEVEL, b"\2"))

    def _tell_off(self, address: int) -> None:
        self._line.write(address, _TORQUE, b"\0")

    def _wait_out(self) -> None:
        self._line.ping(MAX_ID)

    def _scan(self, known: Collection[int]) -> Collection[int]:
        """Return the ids that answer, and those that are `known` to be at the first rate."""
        return {*known, *(status.servo_id for status in self._line.ping_all())}
