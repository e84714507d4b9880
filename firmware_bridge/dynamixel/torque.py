"""Torque of single servos: on without a jump or jerk, off until a read confirms it; watchdogs."""

import struct
from collections.abc import Sequence
from typing import Final

import numpy as np

from firmware_bridge.bus import any_set
from firmware_bridge.bus_kinds import NOT_SEEN
from firmware_bridge.dynamixel.control_table import (
    SOFT_START_S,
    VELOCITY_UNIT_DEG_S,
    WATCHDOG_UNIT_S,
    register,
)
from firmware_bridge.dynamixel.mounting import MountedServo, identify, mismatches
from firmware_bridge.dynamixel.present_state import PresentState
from firmware_bridge.dynamixel.wire import codec
from firmware_bridge.dynamixel.wire.codec import BROADCAST_ID, MAX_ID
from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.serial_servos.mounting import Mounting
from firmware_bridge.transport import Transport

_WRITE_TRIES: Final = 3


def write_verified(line: Line, servo_id: int, address: int, data: bytes) -> bool:
    """Write `data` to one servo from a register's `address` on, until a read shows it there.

    Return whether it did within three tries. An acknowledgement is not enough: it carries no data,
    and may belong to an earlier packet.
    """
    for _ in range(_WRITE_TRIES):
        line.write(servo_id, address, data)
        status = line.read(servo_id, address, len(data))
        if status is not None and status.data == data:
            return True
    return False


_ADDRESS: Final = register("bus_watchdog").address
_LONGEST: Final = 127


class Watchdogs:
    """The servos' bus watchdogs, and whether a pause of our own packets may have tripped them."""

    def __init__(self, ids: Sequence[int], timeout_s: float) -> None:
        """Set for how long servos go on without receiving a packet: `timeout_s`; 0 = for ever."""
        self._ids = tuple(ids)
        self._setting = min(_LONGEST, int(np.ceil(timeout_s / WATCHDOG_UNIT_S - 1e-9)))
        self._trips_after_s = self._setting * WATCHDOG_UNIT_S if self._setting else float("inf")
        self._spoke_s = 0.0
        self._lapsed = False

    @property
    def setting(self) -> int:
        """The value that register `bus_watchdog` must have while torque is on; 0 = no watchdog."""
        return self._setting

    def start(self, line: Line, servo_id: int) -> bool:
        """Clear and start one servo's watchdog; return whether a read shows the new setting.

        A tripped watchdog accepts no goals until it is cleared, and a lost write would leave
        nothing to stop a face whose computer has died.
        """
        cleared = write_verified(line, servo_id, _ADDRESS, b"\0")
        if not (cleared and self._setting):
            return cleared
        return write_verified(line, servo_id, _ADDRESS, bytes((self._setting,)))

    def spoke(self, now_s: float) -> None:
        """Note a packet sent at `now_s`, and whether the pause before it may trip watchdogs."""
        if now_s - self._spoke_s >= self._trips_after_s:
            self._lapsed = True
        self._spoke_s = now_s

    def keep(self, line: Line) -> None:
        """Restart all watchdogs if a pause may have tripped them; to call before every goal."""
        self.spoke(line.transport.clock.now())
        if self._lapsed:
            self._lapsed = False
            for value in (b"\0", bytes((self._setting,))):
                line.tell(codec.sync_write(_ADDRESS, 1, [(each, value) for each in self._ids]))


_PROFILE: Final = register("profile_acceleration").address
_CURRENT: Final = register("goal_current").address
#: A servo whose torque has just come on goes no faster, and pulls no harder where it has a current
#: cap, for a while.
_SOFT_DEG_S: Final = 60.0
_SOFT_STRENGTH: Final = 0.3
#: The servo itself goes this much faster than the gate allows, so that it does not fall behind by
#: rounding. What a person is told as the fastest is the fastest, to a twentieth.
_SPEED_MARGIN: Final = 1.05
#: Nobody acknowledges a sync write: full strength is said so often, this far apart.
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
        slow_deg_s = min(_SOFT_DEG_S, servo.joint.max_speed_deg_s)
        wanted = [(_PROFILE, struct.pack("<II", 0, _velocity(slow_deg_s)))]
        if cap is not None:
            weak = max(1, round(cap * _SOFT_STRENGTH))
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
        """Set servos to full speed and current a second after torque on; to call in every tick."""
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
    return struct.pack("<II", 0, _velocity(servo.joint.max_speed_deg_s * _SPEED_MARGIN))


def _velocity(deg_s: float) -> int:
    """Return a speed in units of the profile velocity register, at least 1: 0 is unlimited."""
    return max(1, min(32_767, round(deg_s / VELOCITY_UNIT_DEG_S)))


_TORQUE, _GOAL = register("torque_enable").address, register("goal_position").address
_PLACE, _LEVEL = register("present_position").address, register("status_return_level").address
#: Torque comes on one servo after another: twenty at once make the supply sag.
_STAGGER_S: Final = 0.010
#: In a tick there is no time for more; whoever is there answers the first or second question.
_TRIES: Final = 2


class TorqueSwitch:
    """Switches torque of one servo at a time. Every method may raise PortError."""

    def __init__(
        self,
        servos: Sequence[MountedServo],
        present: PresentState,
        mounting: Mounting,
        soft_start: SoftStart,
        watchdogs: Watchdogs,
    ) -> None:
        self._servos = tuple(servos)
        self._present = present
        self._cache = present.cache
        self._mounting = mounting
        self._soft_start = soft_start
        self._watchdogs = watchdogs

    def obstacle(self, line: Line, index: int) -> str:
        """Return why this servo cannot hold its present position; empty: it can."""
        return self._place_to_hold(line, index)[0]

    def enable(self, line: Line, index: int) -> str:
        """Switch a servo's torque on at its present position; return why not, "" if confirmed."""
        cache, servo_id = self._cache, self._servos[index].joint.servo_id
        obstacle, place = self._place_to_hold(line, index)
        if obstacle:
            return obstacle
        # First of all, since a tripped watchdog refuses every goal.
        if not self._watchdogs.start(line, servo_id):
            return "does not take its bus watchdog"
        if not write_verified(line, servo_id, _GOAL, struct.pack("<i", place)):
            return "does not take the place where it stands as its goal"
        cache.goals[index] = cache.pulses[index] = place
        cache.set_one("tripped", index, False)
        if not self._soft_start.apply_soft_limits(line, index):
            return "does not take its slow start"
        cache.enabled[index] = True
        if not self._switch(line, index, b"\1"):
            self.disable(line, index)
            return "does not switch its torque on"
        now_s = line.transport.clock.now()
        self._soft_start.note_torque_on(index, now_s)
        self._watchdogs.spoke(now_s)
        line.transport.clock.sleep_until(now_s + _STAGGER_S)
        return ""

    def keep(self, line: Line, index: int) -> bool:
        """Hold a servo with torque on at its present position; return whether it confirmed that.

        False if its torque is off, which it stays, or if it does not confirm watchdog and goal.
        """
        cache, servo_id = self._cache, self._servos[index].joint.servo_id
        torque = line.read(servo_id, _TORQUE, 1)
        if torque is None or not torque.data:
            return False
        self.note(index, torque.data, line.transport.clock.now())
        if torque.data != b"\1":
            return False
        cache.enabled[index] = True
        place = self._place(line, servo_id)
        if place is None or not self._watchdogs.start(line, servo_id):
            return False
        cache.goals[index] = cache.pulses[index] = place
        cache.set_one("tripped", index, False)
        return write_verified(line, servo_id, _GOAL, struct.pack("<i", place))

    def disable(self, line: Line, index: int) -> bool:
        """Switch torque off; return whether the servo confirmed it."""
        limp = self._switch(line, index, b"\0")
        if limp:
            self._cache.enabled[index] = False
        return limp

    def note(self, index: int, read: bytes, now_s: float) -> None:
        """Take what was read at `now_s` of a servo, from register `torque_enable` on."""
        self._cache.torque.note(index, now_s, on=read[0] != 0)

    def _switch(self, line: Line, index: int, wanted: bytes) -> bool:
        """Write register `torque_enable`; return whether a read shows it. Unknown until then."""
        self._cache.torque.forget((index,))
        switched = write_verified(line, self._servos[index].joint.servo_id, _TORQUE, wanted)
        if switched:
            self.note(index, wanted, line.transport.clock.now())
        return switched

    def renew_watchdog(self, line: Line, index: int, found: int) -> None:
        """Restart a servo's watchdog if it is off although torque is on, so that it protects again.

        found: the value read from register `bus_watchdog`.
        """
        tripped, wanted = 0xFF, self._watchdogs.setting
        if self._cache.enabled[index] and found not in (wanted, tripped):
            self._watchdogs.start(line, self._servos[index].joint.servo_id)

    def _place_to_hold(self, line: Line, index: int) -> tuple[str, int]:
        """Return why a servo cannot hold, "" if it can, and its present position.

        The position is in encoder steps; 0: unknown.
        """
        servo, cache = self._servos[index], self._cache
        servo_id = servo.joint.servo_id
        identity = identify(line, servo, tries=_TRIES)
        if identity is None:
            return "does not answer; check its power and cable", 0
        wrong = mismatches(servo, identity)
        if wrong:
            return "; ".join(wrong), 0
        self._present.take_identity(index, identity, line.transport.clock.now())
        line.return_delay_s = float(cache.return_delay_s.max())
        line.write(servo_id, _LEVEL, b"\2")
        place = self._place(line, servo_id)
        if place is None:
            return "does not say where it stands", 0
        return self._mounting.obstacle(index, place, cache.low[index], cache.high[index]), place

    def _place(self, line: Line, servo_id: int) -> int | None:
        for _ in range(_TRIES):
            status = line.read(servo_id, _PLACE, 4)
            if status is not None and len(status.data) == 4:
                return int.from_bytes(status.data, "little", signed=True)
        return None


#: A packet that nobody answers is said this often.
_REPEATS_BY_FORCE: Final = 3
_TORQUE_ENABLE: Final = register("torque_enable").address
_ANSWERS: Final = register("status_return_level").address


class LineRelease:
    """Torque off at an open port, for servos that another process drove before."""

    confirms: Final = True

    def __init__(self, transport: Transport, rates: Sequence[int]) -> None:
        """Set the baud rates at which servos may listen; `transport` is open at the first."""
        self._line = Line(transport)
        self._rates = tuple(dict.fromkeys(rates))

    def tell_all(self, addresses: Sequence[int]) -> None:
        """Send torque off to `addresses` and to all others, several times; read no answer.

        In between, tripped watchdogs are cleared. Servos that were set not to answer, answer from
        now on.
        """
        line = self._line
        everybody = codec.write(BROADCAST_ID, _TORQUE_ENABLE, b"\0")
        blocks = [(each, b"\0") for each in addresses]
        listed = codec.sync_write(_TORQUE_ENABLE, 1, blocks) if blocks else everybody
        for _ in range(_REPEATS_BY_FORCE):
            line.tell(listed)
        line.tell(codec.write(BROADCAST_ID, _ADDRESS, b"\0"))
        line.tell(everybody)
        line.tell(codec.write(BROADCAST_ID, _ANSWERS, b"\2"))

    def ask(self, address: int) -> str:
        """Read whether the servo at `address` has its torque off; return "" if it confirms that.

        Otherwise return the reason, after torque off was sent to it once more.
        """
        status = self._line.read(address, _TORQUE_ENABLE, 1)
        if status is not None and status.data == b"\0":
            return ""
        self._line.write(address, _TORQUE_ENABLE, b"\0")
        return NOT_SEEN if status is None else "kept its torque"

    def find(self, addresses: Sequence[int]) -> Sequence[int]:
        """Send torque off at every baud rate; return `addresses` and the ids that answer a ping.

        A chain has one rate: pings end at the first rate at which an id is known, by `addresses` or
        by an answer.
        """
        line, found = self._line, set(addresses)
        for rate in self._rates:
            line.baud_rate = rate
            self.tell_all(addresses)
            line.ping(MAX_ID)  # until its time is over the packets before are on the wire
        for rate in self._rates:
            line.baud_rate = rate
            found |= {status.servo_id for status in line.ping_all()}
            if found:
                break
        return sorted(found)

    def close(self) -> None:
        """Close the port."""
        self._line.transport.close()
