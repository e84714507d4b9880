"""Torque of single Feetech servos: on without a jump or jerk, off until confirmed, off by force."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from firmware_bridge.bus import Array
from firmware_bridge.bus_kinds import NOT_SEEN
from firmware_bridge.feetech import codec
from firmware_bridge.feetech.control_table import CONTROL, SOFT_START_S, TORQUE_ENABLE
from firmware_bridge.feetech.line import Line
from firmware_bridge.feetech.mounting import MountedServo, ServoIdentity, identify, mismatches
from firmware_bridge.feetech.present_state import PresentState
from firmware_bridge.serial_servos.mounting import Mounting
from firmware_bridge.transport import Transport

_WRITE_TRIES: Final = 3
#: A servo whose torque has just come on goes no faster, and pulls no harder, for a while.
_SOFT_DEG_S: Final = 60.0
_SOFT_STRENGTH: Final = 0.3
#: The servo itself goes this much faster than the gate allows, so that it does not fall behind.
_SPEED_MARGIN: Final = 1.05
#: Torque comes on one servo after another: twenty at once make the supply sag.
_STAGGER_S: Final = 0.010
#: In a tick there is no time for more.
_TRIES: Final = 2


def write_verified(line: Line, servo_id: int, address: int, data: bytes) -> bool:
    """Write `data` to one servo from a register's `address` on, until a read shows it there.

    Return whether it did within three tries.
    """
    for _ in range(_WRITE_TRIES):
        line.write(servo_id, address, data)
        status = line.read(servo_id, address, len(data))
        if status is not None and status.data == data:
            return True
    return False


def torque_verified(line: Line, servo_id: int, *, on: bool) -> bool:
    """Set torque to `on` until a read confirms it, three times at most; return whether it did."""
    for _ in range(_WRITE_TRIES):
        line.tell(codec.torque((servo_id,), on=on))
        status = line.read(servo_id, TORQUE_ENABLE, 1)
        if status is not None and status.data == (b"\1" if on else b"\0"):
            return True
    return False


class TorqueSwitch:
    """Switches torque of one servo at a time. Every method may raise PortError.

    A goal switches torque on by itself in servos that are limp, so a servo gets its limits before
    its goal, its goal before its torque, and no goals once its torque goes off.
    """

    def __init__(
        self, servos: Sequence[MountedServo], present: PresentState, mounting: Mounting
    ) -> None:
        n = len(servos)
        self._servos = tuple(servos)
        self._present = present
        self._cache = present.cache
        #: Who gets goals: a goal may switch torque on.
        self.driven = np.zeros(n, dtype=np.bool_)
        #: Who gets none until its bounds were read, having been silent.
        self.doubted = np.zeros(n, dtype=np.bool_)
        self._mounting = mounting
        self._dialect = servos[0].model.dialect
        self._identities: list[ServoIdentity | None] = [None] * n
        #: Registers goal_speed: of a start, and the most that a goal may bring now; and of one step
        #: of the position register a second.
        self.slow, self.top, self.units = np.ones(n), np.ones(n), np.ones(n)
        #: What torque_limit was set to, and when the bounds of a start fall; infinite: they have.
        self._strengths = [0] * n
        self._full_at_s = np.full(n, np.inf)
        self._goal = self._dialect.registers["goal_position"].address

    def note_identity(self, index: int, found: ServoIdentity, now_s: float) -> None:
        """Store a servo's own settings, read at `now_s`, which are used from now on."""
        self._identities[index] = found
        self._present.take_identity(index, found, now_s)

    @property
    def at_full_strength(self) -> bool:
        """Whether no servo with torque on is still limited by its slow start."""
        return not np.isfinite(self._full_at_s).any()

    def obstacle(self, line: Line, index: int) -> str:
        """Return why this servo cannot hold its present position; empty: it can."""
        return self._place_to_hold(line, index)[0]

    def enable(self, line: Line, index: int) -> str:
        """Switch a servo's torque on at its present position; return why not, "" if confirmed."""
        cache = self._cache
        obstacle, place = self._place_to_hold(line, index)
        if obstacle:
            return obstacle
        if not self._bound(line, index, soft=True):
            return "does not take its slow start"
        cache.enabled[index] = True
        cache.torque.forget((index,))  # a goal may switch it on
        if not self._take_goal(line, index, place):
            self._switch(line, index, on=False)
            return "does not take the place where it stands as its goal"
        if not self._switch(line, index, on=True):
            self.disable(line, index)
            return "does not switch its torque on"
        self.driven[index] = True
        now_s = line.transport.clock.now()
        self._full_at_s[index] = now_s + SOFT_START_S
        line.transport.clock.sleep_until(now_s + _STAGGER_S)
        return ""

    def keep(self, line: Line, index: int) -> bool:
        """Hold a servo with torque on at its present position; return whether it confirmed.

        False if its torque is off, which it stays, or if it does not confirm limits and goal.
        """
        cache, servo_id = self._cache, self._servos[index].joint.servo_id
        torque = line.read(servo_id, TORQUE_ENABLE, 1)
        if torque is None:
            return False
        cache.torque.note(index, line.transport.clock.now(), on=torque.data != b"\0")
        if torque.data != b"\1" or self._identities[index] is None:
            return False
        cache.enabled[index] = True
        obstacle, place = self._place_to_hold(line, index)
        if obstacle or not self._bound(line, index, soft=False):
            return False
        self.driven[index] = self._take_goal(line, index, place)
        return bool(self.driven[index])

    def disable(self, line: Line, index: int) -> bool:
        """Switch torque off; return whether the servo confirmed it."""
        self.driven[index] = self.doubted[index] = False
        self._full_at_s[index] = np.inf
        limp = self._switch(line, index, on=False)
        if limp:
            self._cache.enabled[index] = False
        return limp

    def disable_all(self) -> None:
        """Mark all servos as not driven: none gets goals or full strength now; sends nothing."""
        self.driven[:] = self.doubted[:] = False
        self._full_at_s[:] = np.inf

    def doubt(self, ages_s: Array) -> None:
        """Withhold goals from driven servos that have just missed an answer.

        Parameters
        ----------
        ages_s : Array
            (n_servos,) seconds; 0 for servos that just answered.
        """
        silent = self.driven & (ages_s > 0.0)
        self.doubted |= silent
        self.driven &= ~silent

    def look_after(self, line: Line, index: int, control: bytes) -> None:
        """Set full strength when due; switch off a servo that lost its limits in a restart.

        control: its registers from `CONTROL` on, read just now. After a brown-out a servo may come
        back with torque on.
        """
        self._cache.torque.note(index, line.transport.clock.now(), on=control[0] != 0)
        if self.doubted[index] and not control[0]:
            self.doubted[index] = False  # it is brought up anew
        if not (self.driven[index] or self.doubted[index]) or not control[0]:
            return
        of, speed = self._dialect, self._dialect.decode("goal_speed", control, CONTROL)
        strength = self._strengths[index]
        if "torque_limit" in of.registers:
            strength = of.decode("torque_limit", control, CONTROL)
        if not 0 < speed <= self.top[index] or strength != self._strengths[index]:
            self.disable(line, index)
            return
        self.driven[index], self.doubted[index] = True, False
        is_due = self._full_at_s[index] <= line.transport.clock.now()
        if is_due and self._bound(line, index, soft=False):
            self._full_at_s[index] = np.inf

    def _switch(self, line: Line, index: int, *, on: bool) -> bool:
        """Switch torque; return whether a read shows it. Unknown until then."""
        self._cache.torque.forget((index,))
        switched = torque_verified(line, self._servos[index].joint.servo_id, on=on)
        if switched:
            self._cache.torque.note(index, line.transport.clock.now(), on=on)
        return switched

    def _bound(self, line: Line, index: int, *, soft: bool) -> bool:
        """Limit a servo's speed and, if possible, its torque; return whether it keeps the limits.

        soft: to the low limits of a start, otherwise to the joint's. A servo that cannot go as fast
        as its setting keeps the most that it can. Full strength is one step below that of a servo
        that has restarted, so that a restart shows.
        """
        servo, found, dialect = self._servos[index], self._identities[index], self._dialect
        if found is None:
            return False
        servo_id, registers = servo.joint.servo_id, dialect.registers
        full_deg_s = servo.joint.max_speed_deg_s * _SPEED_MARGIN
        slow = found.speed_register(min(_SOFT_DEG_S, full_deg_s), dialect)
        speed = slow if soft else found.speed_register(full_deg_s, dialect)
        if "acceleration" in registers:
            line.write(servo_id, registers["acceleration"].address, b"\0")
        if "torque_limit" in registers:
            limit = found.eeprom["max_torque"]
            limit = max(1, round(limit * _SOFT_STRENGTH) if soft else limit - 1)
            data = dialect.encode("torque_limit", limit)
            if not write_verified(line, servo_id, registers["torque_limit"].address, data):
                return False
            self._strengths[index] = limit
        for _ in range(_WRITE_TRIES):
            address = registers["goal_speed"].address
            line.write(servo_id, address, dialect.encode("goal_speed", speed))
            status = line.read(servo_id, address, registers["goal_speed"].size)
            if status is not None:
                kept = dialect.decode("goal_speed", status.data, address)
                if 0 < kept <= speed:
                    self.slow[index], self.top[index] = min(slow, kept), kept
                    self.units[index] = found.speed_unit
                    return True
        return False

    def _take_goal(self, line: Line, index: int, place: int) -> bool:
        data = self._dialect.encode("goal_position", place)
        taken = write_verified(line, self._servos[index].joint.servo_id, self._goal, data)
        if taken:
            self._cache.goals[index] = self._cache.pulses[index] = place
        return taken

    def _place_to_hold(self, line: Line, index: int) -> tuple[str, int]:
        """Return why a servo cannot hold, "" if it can, and its present position.

        The position is in encoder steps; 0: unknown.
        """
        servo, cache = self._servos[index], self._cache
        found = identify(line, servo, tries=_TRIES)
        if found is None:
            return "does not answer; check its power and cable", 0
        wrong = mismatches(servo, found)
        if wrong:
            return "; ".join(wrong), 0
        self.note_identity(index, found, line.transport.clock.now())
        line.return_delay_s = float(cache.return_delay_s.max())
        low, high = cache.low[index], cache.high[index]
        return self._mounting.obstacle(index, found.place, low, high), found.place


class LineRelease:
    """Torque off at an open port, for servos that another process drove before."""

    confirms: Final = True

    def __init__(self, transport: Transport, rates: Sequence[int]) -> None:
        """Set the baud rates at which servos may listen; `transport` is open at the first."""
        self._line = Line(transport)
        self._rates = tuple(dict.fromkeys(rates))

    def tell_all(self, addresses: Sequence[int]) -> None:
        """Send torque off to these addresses and to all servos, twice each."""
        for ids in (tuple(addresses), (), tuple(addresses), ()):
            self._line.tell(codec.torque(ids, on=False))

    def ask(self, address: int) -> str:
        """Read whether the servo at `address` has its torque off; return "" if it confirms that.

        Otherwise return the reason, after torque off was sent to it once more.
        """
        status = self._line.read(address, TORQUE_ENABLE, 1)
        if status is not None and status.data == b"\0":
            return ""
        self._line.tell(codec.torque((address,), on=False))
        return NOT_SEEN if status is None else "kept its torque"

    def find(self, addresses: Sequence[int]) -> Sequence[int]:
        """Send torque off at every baud rate; return `addresses` and the ids that a scan finds.

        A chain has one rate: once servos answer at a rate, no further rates are scanned.
        """
        line, found = self._line, set(addresses)
        for rate in self._rates:
            line.baud_rate = rate
            self.tell_all(addresses)
            line.read(codec.MAX_ID, TORQUE_ENABLE, 1)  # its time over, the packets before are out
        for rate in self._rates:
            line.baud_rate = rate
            heard = line.scan()
            found |= set(heard)
            if heard:
                break
        return sorted(found)

    def close(self) -> None:
        """Close the port."""
        self._line.transport.close()
