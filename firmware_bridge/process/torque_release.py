"""Torque off where no bridge runs any more: open the port and let every joint go limp."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from firmware_bridge.dynamixel.control_table import register
from firmware_bridge.dynamixel.wire import codec
from firmware_bridge.dynamixel.wire.codec import BROADCAST_ID, MAX_ID
from firmware_bridge.dynamixel.wire.line import Line, Transport
from firmware_bridge.errors import BusError, PortError

_TORQUE, _WATCHDOG = register("torque_enable").address, register("bus_watchdog").address
_LEVEL = register("status_return_level").address
#: A packet that nobody answers is said this often; each servo is asked this often at least.
_REPEATS: Final = 3
_RETRY_S: Final = 0.05
_NOT_SEEN: Final = "did not answer"
_STILL_ON: Final = "kept its torque"


class TorqueRelease:
    """Torque off by force, one small step a call, so that a loop can go on meanwhile.

    confirmed: the ids that were read limp; unconfirmed: why the others were not; port_error: why
    the port cannot be opened just now, empty once it is.
    """

    def __init__(
        self,
        open_transport: Callable[[], Transport],
        ids: Sequence[int],
        *,
        timeout_s: float = 0.0,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        """timeout_s: how long servos are asked again that do not answer; three times at least."""
        self._open_transport = open_transport
        self._ids = tuple(ids)
        self._timeout_s = timeout_s
        self._now_s = now_s
        self._line: Line | None = None
        self._opened_s = 0.0
        self._left: list[int] = []
        self._n_rounds = 0
        self.next_s = 0.0
        self.done = False
        self.port_error = ""
        self.confirmed: list[int] = []
        self.unconfirmed: dict[int, str] = dict.fromkeys(self._ids, _NOT_SEEN)

    @property
    def is_open(self) -> bool:
        """Whether the servos have been told."""
        return self._line is not None

    def step(self) -> bool:
        """Open the port, or tell all, or ask one; whether it is over. Never raises BusError."""
        if self.done:
            return True
        try:
            if self._line is None:
                self._open()
            elif self._left:
                self._ask(self._line, self._left.pop(0))
            else:
                self._next_round(self._line)
        except BusError as error:
            self.close()
            self.port_error = str(error)
            self.next_s = self._now_s() + _RETRY_S
        return self.done

    def close(self) -> None:
        """Give the port back."""
        if self._line is not None:
            self._line.transport.close()
            self._line = None

    def _open(self) -> None:
        transport = self._open_transport()
        self._line = Line(transport)
        self.port_error = ""
        self._opened_s = self._now_s()
        self._n_rounds = 0
        self.confirmed = []
        self.unconfirmed = dict.fromkeys(self._ids, _NOT_SEEN)
        tell_all_limp(self._line, self._ids)

    def _next_round(self, line: Line) -> None:
        if self._n_rounds:
            tell_all_limp(line, list(self.unconfirmed))
        waited_s = self._now_s() - self._opened_s
        enough = self._n_rounds >= _REPEATS and waited_s >= self._timeout_s
        if not self.unconfirmed or enough:
            self.close()
            self.done = True
            return
        self._left = list(self.unconfirmed)
        self._n_rounds += 1

    def _ask(self, line: Line, servo_id: int) -> None:
        why = ask_whether_limp(line, servo_id)
        if why:
            self.unconfirmed[servo_id] = why
        else:
            del self.unconfirmed[servo_id]
            self.confirmed.append(servo_id)


def tell_all_limp(line: Line, ids: Sequence[int]) -> None:
    """Torque off to everybody, again and again; a tripped watchdog is cleared in between.

    Whoever was told not to answer, answers from now on.
    """
    everybody = codec.write(BROADCAST_ID, _TORQUE, b"\0")
    listed = codec.sync_write(_TORQUE, 1, [(each, b"\0") for each in ids]) if ids else everybody
    for _ in range(_REPEATS):
        line.tell(listed)
    line.tell(codec.write(BROADCAST_ID, _WATCHDOG, b"\0"))
    line.tell(everybody)
    line.tell(codec.write(BROADCAST_ID, _LEVEL, b"\2"))


def ask_whether_limp(line: Line, servo_id: int) -> str:
    """Empty when the servo says that its torque is off; else why not, and it is told once more."""
    status = line.read(servo_id, _TORQUE, 1)
    if status is not None and status.data == b"\0":
        return ""
    line.write(servo_id, _TORQUE, b"\0")
    return _NOT_SEEN if status is None else _STILL_ON


@dataclass(frozen=True, slots=True)
class Released:
    """Which servos of one port are limp, and which are not, with the reason."""

    confirmed: list[int] = field(default_factory=list)
    unconfirmed: Mapping[int, str] = field(default_factory=dict)


def release_port(
    open_transport: Callable[[int], Transport],
    rates: Sequence[int],
    ids: Sequence[int] = (),
    *,
    timeout_s: float = 0.0,
) -> Released:
    """Torque off at a port: everybody is told at every rate, whoever is found is asked.

    ids: must be found, at the first rate. A chain has one rate: the others are not searched once
    servos were found. Waits up to `timeout_s` for the port. Raises PortError when it cannot be
    opened.
    """
    transport = _opened(open_transport, rates[0], timeout_s)
    try:
        line = Line(transport)
        for rate in dict.fromkeys(rates):
            line.baud_rate = rate
            tell_all_limp(line, ids)
            line.ping(MAX_ID)  # until its time is over the packets before are on the wire
        for rate in dict.fromkeys(rates):
            line.baud_rate = rate
            found = {status.servo_id for status in line.ping_all()}
            asked = sorted(found | set(ids))
            if found or ids:
                break
        left = {each: why for each in asked if (why := _asked_often(line, each))}
    finally:
        transport.close()
    return Released([each for each in asked if each not in left], left)


def _asked_often(line: Line, servo_id: int) -> str:
    """Empty as soon as the servo says that it is limp; else why not."""
    why = _NOT_SEEN
    for _ in range(_REPEATS):
        why = ask_whether_limp(line, servo_id)
        if not why:
            break
    return why


def _opened(open_transport: Callable[[int], Transport], rate: int, timeout_s: float) -> Transport:
    give_up_s = time.monotonic() + timeout_s
    while True:
        try:
            return open_transport(rate)
        except PortError:
            if time.monotonic() >= give_up_s:
                raise
            time.sleep(_RETRY_S)
