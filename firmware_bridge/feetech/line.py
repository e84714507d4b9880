"""One half-duplex line of Feetech servos: questions and answers, who may speak when, deadlines."""

from collections.abc import Callable, Sequence
from typing import Any, Final

from firmware_bridge.dynamixel.wire.codec import BITS_PER_BYTE
from firmware_bridge.dynamixel.wire.line import LearntLatency, PendingAnswers
from firmware_bridge.feetech import codec
from firmware_bridge.feetech.codec import (
    EMPTY_SIZE,
    MAX_ID,
    SpanRead,
    Status,
    packets_in,
    statuses_in,
)
from firmware_bridge.transport import Transport

#: Of several servos: one undisturbed stream of all, or those that came whole, one by one.
Answers = bytes | list[Status]

#: Return delay as the longest that the register holds: 254 x 2 us.
LONGEST_RETURN_DELAY_S: Final = 0.00051
#: firmware (2 bytes), byte order, model number (2).
IDENTITY_SIZE: Final = 5
#: Between two questions of a scan: adapters and computers may be late with an answer, servos not.
_SCAN_GAP_S: Final = 0.001
_SCAN_WAIT_S: Final = 0.06
#: Silent this often in a row: asked last, since it may cut off the rest; then only now and then.
_SUSPECT_AFTER, _ABSENT_AFTER = 2, 5
_RETRY_EVERY: Final = 200


class Line:
    """Master of the line. Not thread-safe; every method raises PortError when the port fails.

    A servo that does not answer is no error but a missing status. Nothing is sent before the
    computed end of the last transaction, and an answer that could be the late one to another
    question does not count: the question is asked in another length.
    spoilt: something came in answer to the last question, but not what was asked.
    extra_wait_s: how long beyond its time an answer is waited for; for commands outside the loop.
    """

    def __init__(
        self,
        transport: Transport,
        return_delay_s: float = LONGEST_RETURN_DELAY_S,
        *,
        extra_wait_s: float = 0.0,
    ) -> None:
        """return_delay_s: the slowest servo's; it lengthens deadlines, not the wire."""
        self.transport = transport
        self.return_delay_s = return_delay_s
        self.byte_s = BITS_PER_BYTE / transport.baud_rate
        self.spoilt = False
        self.echoes = False
        self._extra_wait_s = extra_wait_s
        self._clock = transport.clock
        self._latency = LearntLatency()
        self._pending = PendingAnswers()
        self._quiet_s = self._sent_s = 0.0
        self._heard = b""  # in answer to a question that was not answered as asked

    @property
    def baud_rate(self) -> int:
        """Bits a second on the wire."""
        return self.transport.baud_rate

    @baud_rate.setter
    def baud_rate(self, baud_rate: int) -> None:
        self.transport.baud_rate = baud_rate
        self.byte_s = BITS_PER_BYTE / baud_rate

    def read(
        self, servo_id: int, address: int, size: int, extra_wait_s: float = 0.0
    ) -> Status | None:
        """`size` bytes of one servo. extra_wait_s: waited for longer than an answer should take."""
        wide = size
        if self._pending.any and self._pending.expire(self._clock.now()):
            wide = self._pending.free_size((servo_id,), size)
        request = codec.read(servo_id, address, wide)

        def take(stream: bytes) -> Status | None:
            found = statuses_in(stream)
            fitting = (s for s in found if s.servo_id == servo_id and len(s.data) == wide)
            return next(fitting, None)

        status: Status | None = self._transact(request, wide + EMPTY_SIZE, take, 1, extra_wait_s)
        if status is None:
            self._pending.note(servo_id, wide, request, self._clock.now())
            return None
        return status if wide == size else status._replace(data=status.data[:size])

    def write(self, servo_id: int, address: int, data: bytes, extra_wait_s: float = 0.0) -> None:
        """Set bytes of one servo. What it acknowledges says nothing: read it back."""

        def take(stream: bytes) -> Status | None:
            return next((s for s in statuses_in(stream) if s.servo_id == servo_id), None)

        self._transact(codec.write(servo_id, address, data), EMPTY_SIZE, take, 1, extra_wait_s)

    def tell(self, request: bytes) -> None:
        """Send what nobody answers."""
        self._send(request)

    def sync_read(self, span: SpanRead) -> Answers:
        """The answers of all as one stream, undisturbed; or those that came whole, one by one."""
        wide = span
        if self._pending.any and self._pending.expire(self._clock.now()):
            size = self._pending.free_size(span.ids, span.size)
            wide = span if size == span.size else SpanRead(span.ids, span.address, size)

        def take(stream: bytes) -> Answers | None:
            if wide.is_undisturbed(stream):
                return stream
            found = self._salvaged(wide, stream)
            return found if len(found) == len(wide.ids) else None

        n = len(span.ids)
        taken: Answers | None = self._transact(wide.request, wide.reply_size, take, n)
        if isinstance(taken, bytes) and wide is span:
            return taken
        if taken is None:
            taken = self._salvaged(wide, self._heard)
            for missing in {*wide.ids} - {status.servo_id for status in taken}:
                self._pending.note(missing, wide.size, wide.request, self._clock.now())
        statuses = statuses_in(taken) if isinstance(taken, bytes) else taken
        return [status._replace(data=status.data[: span.size]) for status in statuses]

    def scan(self, ids: Sequence[int] = range(MAX_ID + 1)) -> dict[int, list[bytes]]:
        """Who answers, with the model number's two bytes, once for each answer that came whole.

        One question after another; answers are collected at the end, so that a computer or adapter
        that is late with them loses none. Half a second for all ids at 1 Mbaud.
        """
        self.transport.discard_input()
        heard = b""
        slot_s = (EMPTY_SIZE + IDENTITY_SIZE) * self.byte_s + self.return_delay_s + _SCAN_GAP_S
        for servo_id in ids:
            sent_s = self._send(codec.read(servo_id, 0, IDENTITY_SIZE))
            self._clock.sleep_until(sent_s + slot_s)
            heard += self.transport.discard_input()
        while more := self.transport.read(self._clock.now() + _SCAN_WAIT_S):
            heard += more
        found: dict[int, list[bytes]] = {}
        self.spoilt = False
        for status, _ in packets_in(heard):
            self.spoilt |= status is None
            if status is not None and len(status.data) == IDENTITY_SIZE:
                found.setdefault(status.servo_id, []).append(status.data[3:])
        return found

    def _salvaged(self, span: SpanRead, stream: bytes) -> list[Status]:
        by_id = {s.servo_id: s for s in statuses_in(stream) if len(s.data) == span.size}
        return [by_id[each] for each in span.ids if each in by_id]

    def _send(self, request: bytes) -> float:
        """When the last byte will be on the wire; our own bytes queue up and need no waiting."""
        now_s = self._clock.now()
        if now_s < self._quiet_s:
            self._clock.sleep_until(self._quiet_s)
            now_s = self._clock.now()
        self.transport.write(request)
        self._sent_s = max(now_s, self._sent_s) + len(request) * self.byte_s
        return self._sent_s

    def _transact(
        self,
        request: bytes,
        reply_size: int,
        take: Callable[[bytes], Any],
        n_turns: int,
        extra_wait_s: float = 0.0,
    ) -> Any:
        """Send, then read until `take` makes something of it, or None: the reply's time is over."""
        transport, clock, latency = self.transport, self._clock, self._latency
        extra_wait_s = max(extra_wait_s, self._extra_wait_s)
        transport.discard_input()
        due_s = self._send(request) + reply_size * self.byte_s
        end_s = due_s + n_turns * self.return_delay_s
        deadline_s = end_s + latency.slack_s + extra_wait_s
        clock.sleep_until(due_s)
        heard = b""
        while more := transport.read(deadline_s):
            heard += more
            if heard.startswith(request):  # an adapter that gives back what is sent
                heard, self.echoes = heard[len(request) :], True
            if len(heard) >= reply_size and (taken := take(heard)) is not None:
                self._quiet_s = clock.now()
                if not extra_wait_s:
                    latency.learn(self._quiet_s - due_s)
                self.spoilt = False
                return taken
            if heard and not extra_wait_s:
                rest_s = max(end_s, clock.now()) + latency.rest_slack_s
                deadline_s = min(deadline_s, rest_s)
        self._heard = heard
        self._quiet_s = max(end_s, clock.now())
        self.spoilt = bool(heard)
        return None


class Group:
    """The same bytes of all `ids`, in one question where the dialect has it; doubtful ones last.

    leaves_out: whether some are silent for so long that they are asked only now and then.
    """

    def __init__(self, ids: Sequence[int], address: int, size: int, *, sync: bool) -> None:
        self.ids = tuple(ids)
        self._address, self._size, self._sync = address, size, sync
        self.reset()

    def reset(self) -> None:
        """Forget who was silent."""
        self._silent = dict.fromkeys(self.ids, 0)
        self._n_asked = 0
        self._all_well = True
        self.leaves_out = False
        self._span = SpanRead(self.ids, self._address, self._size)

    def ask(self, line: Line) -> Answers:
        """A stream of all answers in the order of the ids; else the answers that came."""
        self._n_asked += 1
        if self.leaves_out and self._n_asked % _RETRY_EVERY in (0, 1):
            self._prepare(retry=self._n_asked % _RETRY_EVERY == 0)
        span = self._span
        found: Answers
        if self._sync:
            found = line.sync_read(span)
        else:
            asked = (line.read(each, self._address, self._size) for each in span.ids)
            found = [status for status in asked if status is not None]
        whole = span.reply_size if isinstance(found, bytes) else len(span.ids)
        if self._all_well and len(found) == whole:
            return found
        if isinstance(found, bytes):
            found = statuses_in(found)
        self._judge({status.servo_id for status in found})
        return found

    def trust(self, servo_id: int) -> None:
        """It has been heard elsewhere: ask it again, if it was left out."""
        if self._silent[servo_id] >= _ABSENT_AFTER:
            self._silent[servo_id] = 0
            self._prepare()

    def _judge(self, answered: set[int]) -> None:
        """Nobody at all: line or computer stood still, and come back with everybody."""
        for servo_id in self._span.ids:
            if servo_id in answered:
                self._silent[servo_id] = 0
            elif answered:
                self._silent[servo_id] = min(self._silent[servo_id] + 1, _ABSENT_AFTER)
        self._prepare()

    def _prepare(self, *, retry: bool = False) -> None:
        silent = self._silent
        trusted = [each for each in self.ids if silent[each] < _SUSPECT_AFTER]
        doubtful = [
            each
            for each in self.ids
            if silent[each] >= _SUSPECT_AFTER and (retry or silent[each] < _ABSENT_AFTER)
        ]
        ids = tuple(trusted + doubtful) or self.ids
        self.leaves_out = any(n >= _ABSENT_AFTER for n in silent.values())
        self._all_well = not any(silent.values())
        if ids != self._span.ids:
            self._span = SpanRead(ids, self._address, self._size)
