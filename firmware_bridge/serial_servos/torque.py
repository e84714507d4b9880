"""Torque of single serial servos: on without a jump or jerk, off until confirmed, off by force."""

import contextlib
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Sequence
from typing import Any, ClassVar, Final, Generic, TypeVar

from firmware_bridge.bus_kinds import NOT_SEEN
from firmware_bridge.errors import RateError
from firmware_bridge.serial_servos.half_duplex import HalfDuplex
from firmware_bridge.serial_servos.mounting import MountedServo, Mounting
from firmware_bridge.transport import Transport

#: Soft start: highest speed, and share of the full strength, for a while after torque comes on.
SOFT_DEG_S: Final = 60.0
SOFT_STRENGTH: Final = 0.3
#: The servo's own speed limit is this much above the joint's, so that rounding does not make it
#: fall behind; a joint is thus at most a twentieth faster than its setting, but for rounding.
SPEED_MARGIN: Final = 1.05
#: How often a write is tried, and a read within a tick, where time is short.
WRITE_TRIES, TRIES = 3, 2
#: Torque comes on one servo after another: twenty at once make the supply sag.
_STAGGER_S: Final = 0.010


_Line = TypeVar("_Line", bound=HalfDuplex)


def write_verified(line: HalfDuplex, servo_id: int, address: int, data: bytes) -> bool:
    """Write `data` to one servo from a register's `address` on, until a read shows it there.

    Return whether it did within three tries. An acknowledgement is not enough: it carries no data,
    and may belong to an earlier packet.
    """
    for _ in range(WRITE_TRIES):
        line.write(servo_id, address, data)
        status = line.read(servo_id, address, len(data))
        if status is not None and status.data == data:
            return True
    return False


class SerialTorqueSwitch(ABC, Generic[_Line]):
    """Switches torque of one servo at a time. Every method may raise PortError.

    torque_address: of register torque_enable. identify, mismatches: the functions of the servos'
    `mounting`. A subclass for each kind of servo adds the abstract methods.
    """

    torque_address: ClassVar[int]
    identify: ClassVar[Callable[..., Any]]
    mismatches: ClassVar[Callable[..., list[str]]]

    def __init__(
        self, servos: Sequence[MountedServo[Any]], present: Any, mounting: Mounting
    ) -> None:
        """Switch torque of `servos`, whose state is `present`, a `PresentState`."""
        self._servos = tuple(servos)
        self._present = present
        self._cache = present.cache
        self._mounting = mounting

    def obstacle(self, line: _Line, index: int) -> str:
        """Return why this servo cannot hold its present position; empty: it can."""
        return self._place_to_hold(line, index)[0]

    def enable(self, line: _Line, index: int) -> str:
        """Switch a servo's torque on at its present position; return why not, "" if confirmed.

        Goal and soft limits are set before, so that nothing moves. Takes 10 ms more than its
        packets, since torque of many servos at once makes the supply sag.
        """
        why, place = self._place_to_hold(line, index)
        if why or (why := self._prepare(line, index, place)):
            return why
        self._cache.enabled[index] = True
        if not self._switch(line, index, on=True):
            self.disable(line, index)
            return "does not switch its torque on"
        now_s = line.transport.clock.now()
        self._begin_soft_start(index, now_s)
        line.transport.clock.sleep_until(now_s + _STAGGER_S)
        return ""

    def keep(self, line: _Line, index: int) -> bool:
        """Hold a servo with torque on at its present position; return whether it confirmed that.

        Never switches torque on. False if torque is off, if the servo does not answer, or if reads
        do not confirm goal and protections (limits, watchdog).
        """
        status = line.read(self._servos[index].joint.servo_id, self.torque_address, 1)
        if status is None or not status.data:
            return False
        self.note(index, status.data, line.transport.clock.now())
        return status.data == b"\1" and self._hold(line, index)

    def disable(self, line: _Line, index: int) -> bool:
        """Switch torque off; return whether the servo confirmed it."""
        limp = self._switch(line, index, on=False)
        if limp:
            self._cache.enabled[index] = False
        return limp

    def note(self, index: int, read: bytes, now_s: float) -> None:
        """Store whether torque is on, by the bytes `read` from `torque_enable` on at `now_s`."""
        self._cache.torque.note(index, now_s, on=read[0] != 0)

    @property
    @abstractmethod
    def at_full_strength(self) -> bool:
        """Whether every servo with torque on has its full speed and strength."""

    @abstractmethod
    def cancel(self) -> None:
        """End all soft starts, since torque goes off everywhere; sends nothing."""

    def take_identity(self, index: int, found: Any, now_s: float) -> None:
        """Store a servo's own settings, read at `now_s`, which are used from now on."""
        self._present.take_identity(index, found, now_s)

    @abstractmethod
    def _prepare(self, line: _Line, index: int, place: int) -> str:
        """Set all that a servo must have before its torque comes on; return what it refuses."""

    @abstractmethod
    def _hold(self, line: _Line, index: int) -> bool:
        """Hold a servo whose torque was just read to be on; return whether it confirmed."""

    @abstractmethod
    def _begin_soft_start(self, index: int, now_s: float) -> None: ...

    @abstractmethod
    def _set_torque(self, line: _Line, servo_id: int, *, on: bool) -> bool:
        """Switch torque; return whether a read shows it."""

    def _place(self, _line: _Line, _servo_id: int, found: Any) -> int | None:
        """Return the position register of a servo just identified; None: the servo is silent."""
        return int(found.place)

    def _switch(self, line: _Line, index: int, *, on: bool) -> bool:
        """Switch torque; return whether a read shows it. Unknown until then."""
        self._cache.torque.forget((index,))
        switched = self._set_torque(line, self._servos[index].joint.servo_id, on=on)
        if switched:
            self._cache.torque.note(index, line.transport.clock.now(), on=on)
        return switched

    def _place_to_hold(self, line: _Line, index: int) -> tuple[str, int]:
        """Identify a servo; return why it cannot hold ("": it can) and its present position.

        The position is the value of its position register; 0: unknown. Stores the limits and the
        return delay that the servo reports.
        """
        servo, cache, kind = self._servos[index], self._cache, type(self)
        found = kind.identify(line, servo, tries=TRIES)
        if found is None:
            return "does not answer; check its power and cable", 0
        if wrong := kind.mismatches(servo, found):
            return "; ".join(wrong), 0
        self.take_identity(index, found, line.transport.clock.now())
        line.return_delay_s = float(cache.return_delay_s.max())
        place = self._place(line, servo.joint.servo_id, found)
        if place is None:
            return "does not say where it stands", 0
        return self._mounting.obstacle(index, place, cache.low[index], cache.high[index]), place


class SerialRelease(ABC, Generic[_Line]):
    """Torque off at an open port, for servos that another process drove before."""

    confirms: Final = True
    torque_address: ClassVar[int]
    #: Makes a line at an open port.
    make_line: Callable[[Transport], _Line]

    def __init__(self, transport: Transport, rates: Sequence[int]) -> None:
        """Set the baud rates at which servos may listen; `transport` is open at one of them."""
        self._line = self.make_line(transport)
        self._rates = tuple(dict.fromkeys(rates))

    def ask(self, address: int) -> str:
        """Read whether the servo at `address` has its torque off; return "" if it confirms that.

        Otherwise return the reason, after torque off was sent to it once more.
        """
        status = self._line.read(address, self.torque_address, 1)
        if status is not None and status.data == b"\0":
            return ""
        self._tell_off(address)
        return NOT_SEEN if status is None else "kept its torque"

    def find(self, addresses: Sequence[int]) -> Sequence[int]:
        """Send torque off at every baud rate; return `addresses` and the ids that answer, sorted.

        All servos of a chain have one rate: the scan ends at the first rate at which ids are known.
        These are ids that answer, and for Dynamixels also `addresses`. Rates that the adapter
        cannot do are left out.
        """
        line, found = self._line, set(addresses)
        for rate in self._rates:
            with contextlib.suppress(RateError):
                line.baud_rate = rate
                self.tell_all(addresses)
                self._wait_out()
        for rate in self._rates:
            with contextlib.suppress(RateError):
                line.baud_rate = rate
                heard = self._scan(found)
                found |= set(heard)
                if heard:
                    break
        return sorted(found)

    def close(self) -> None:
        """Close the port."""
        self._line.transport.close()

    @abstractmethod
    def tell_all(self, addresses: Sequence[int]) -> None:
        """Send torque off to `addresses` and to all others, several times; read no answer."""

    @abstractmethod
    def _tell_off(self, address: int) -> None: ...

    @abstractmethod
    def _wait_out(self) -> None:
        """Read an id that no servo has: when its time is over, all packets are on the wire."""

    @abstractmethod
    def _scan(self, known: Collection[int]) -> Collection[int]:
        """Return the ids that answer at the present rate; none: go on to the next rate."""
