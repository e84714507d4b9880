"""One line of Feetech servos: requests to them and their answers."""

from collections.abc import Sequence
from typing import Final

from firmware_bridge.feetech import codec
from firmware_bridge.feetech.codec import (
    EMPTY_SIZE,
    MAX_ID,
    SpanRead,
    Status,
    packets_in,
    statuses_in,
)
from firmware_bridge.serial_servos.half_duplex import HalfDuplex
from firmware_bridge.transport import Transport

#: Answers of several servos: the bytes of all, undisturbed and in order, or those that came whole.
Answers = bytes | list[Status]

#: The longest return delay that the register holds: 254 x 2 us.
LONGEST_RETURN_DELAY_S: Final = 0.00051
#: Bytes from address 0: firmware (2), byte order (1), model number (2).
IDENTITY_SIZE: Final = 5
#: Pause between two requests of a scan, and how long late answers are awaited at its end.
_SCAN_GAP_S: Final = 0.001
_SCAN_WAIT_S: Final = 0.06
#: A servo silent this often in a row is read last, since it may cut off those behind it; after five
#: times only in every 200th request.
_SUSPECT_AFTER, _ABSENT_AFTER = 2, 5
_RETRY_EVERY: Final = 200


class Line(HalfDuplex):
    """The computer's side of a line of Feetech servos: sends requests and returns the answers.

    An answer that could be the late answer to an earlier request does not count: the new request is
    sent for another number of bytes.
    """

    def __init__(
        self,
        transport: Transport,
        return_delay_s: float = LONGEST_RETURN_DELAY_S,
        *,
        extra_wait_s: float = 0.0,
    ) -> None:
        """Use the line behind `transport`, an open port; parameters as those of `HalfDuplex`."""
        super().__init__(transport, return_delay_s, extra_wait_s)

    def read(
        self, servo_id: int, address: int, size: int, extra_wait_s: float = 0.0
    ) -> Status | None:
        """Read `size` bytes of one servo from `address` on; None: no answer.

        extra_wait_s: how long to wait beyond the deadline. While a late answer of this size may
        still come, more bytes are read than requested, so that the answers differ in size.
        """
        wide = size
        if self._pending.any and self._pending.expire(self._clock.now()):
            wide = self._pending.free_size((servo_id,), size)
        request = codec.read(servo_id, address, wide)

        def take(stream: bytes, *, last: bool) -> Status | None:  # noqa: ARG001 - whole or nothing
            found = statuses_in(stream)
            fitting = (s for s in found if s.servo_id == servo_id and len(s.data) == wide)
            return next(fitting, None)

        status = self._transact(request, wide + EMPTY_SIZE, take, extra_wait_s=extra_wait_s)
        if status is None:
            self._pending.note(servo_id, wide, request, self._clock.now())
            return None
        return status if wide == size else status._replace(data=status.data[:size])

    def write(self, servo_id: int, address: int, data: bytes, extra_wait_s: float = 0.0) -> None:
        """Set bytes of one servo from `address` on. Read them back: the answer proves nothing.

        extra_wait_s: how long to wait beyond the deadline.
        """

        def take(stream: bytes, *, last: bool) -> Status | None:  # noqa: ARG001 - whole or nothing
            return next((s for s in statuses_in(stream) if s.servo_id == servo_id), None)

        request = codec.write(servo_id, address, data)
        self._transact(request, EMPTY_SIZE, take, extra_wait_s=extra_wait_s)

    def sync_read(self, span: SpanRead) -> Answers:
        """Send request `span`; return the stream of all answers, or the statuses that came whole.

        The stream (bytes) only where every servo answered, undisturbed and in order. While late
        answers of the same size may still come, more bytes are read, and the statuses are cut.
        """
        wide = span
        if self._pending.any and self._pending.expire(self._clock.now()):
            size = self._pending.free_size(span.ids, span.size)
            wide = span if size == span.size else SpanRead(span.ids, span.address, size)

        def take(stream: bytes, *, last: bool) -> Answers | None:
            if wide.is_undisturbed(stream):
                return stream
            by_id = {s.servo_id: s for s in statuses_in(stream) if len(s.data) == wide.size}
            found = [by_id[each] for each in wide.ids if each in by_id]
            return found if last or len(found) == len(wide.ids) else None

        n = len(span.ids)
        taken: Answers = self._transact(wide.request, wide.reply_size, take, n_answers=n) or []
        if isinstance(taken, bytes):
            return taken if wide is span else _cut(statuses_in(taken), span.size)
        for missing in {*wide.ids} - {status.servo_id for status in taken}:
            self._pending.note(missing, wide.size, wide.request, self._clock.now())
        return _cut(taken, span.size)

    def scan(self, ids: Sequence[int] = range(MAX_ID + 1)) -> dict[int, list[bytes]]:
        """Read the model number of each of `ids`; return by id its two bytes, once for each answer.

        After each request the line is left free for an answer's time on the wire; all bytes are
        parsed at the end, so that answers which computer or adapter delays are found as well. Takes
        half a second for all ids at 1 Mbaud.
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
        self.heard_noise = False
        for status, _ in packets_in(heard):
            self.heard_noise |= status is None
            if status is not None and len(status.data) == IDENTITY_SIZE:
                found.setdefault(status.servo_id, []).append(status.data[3:])
        return found


def _cut(statuses: Sequence[Status], size: int) -> list[Status]:
    return [status._replace(data=status.data[:size]) for status in statuses]


class Group:
    """A request for the same bytes of all `ids`, one packet if the dialect has sync read.

    Unreliable ids come last. leaves_out: whether servos have been silent for so long that they are
    polled only now and then.
    """

    def __init__(self, ids: Sequence[int], address: int, size: int, *, sync: bool) -> None:
        self.ids = tuple(ids)
        self._address, self._size, self._sync = address, size, sync
        self.reset()

    def reset(self) -> None:
        """Start anew: no servo counts as silent.

        `_silent`: by id, how often in a row a servo did not answer; `_all_well`: none was silent.
        """
        self._silent = dict.fromkeys(self.ids, 0)
        self._n_requests = 0
        self._all_well = True
        self.leaves_out = False
        self._span = SpanRead(self.ids, self._address, self._size)

    def ask(self, line: Line) -> Answers:
        """Send the request; return the stream of all answers, or the statuses that arrived whole.

        The stream (bytes) only where every servo answered, undisturbed and in order.
        """
        self._n_requests += 1
        # Every 200th request includes the servos left out; the next one leaves them out again.
        if self.leaves_out and self._n_requests % _RETRY_EVERY in (0, 1):
            self._prepare(retry=self._n_requests % _RETRY_EVERY == 0)
        span = self._span
        found: Answers
        if self._sync:
            found = line.sync_read(span)
        else:
            requests = (line.read(each, self._address, self._size) for each in span.ids)
            found = [status for status in requests if status is not None]
        # All answers came: so many bytes, or so many statuses.
        whole = span.reply_size if isinstance(found, bytes) else len(span.ids)
        if self._all_well and len(found) == whole:
            return found
        if isinstance(found, bytes):
            found = statuses_in(found)
        self._judge({status.servo_id for status in found})
        return found

    def trust(self, servo_id: int) -> None:
        """Include a servo again that was left out, since it has answered another read."""
        if self._silent[servo_id] >= _ABSENT_AFTER:
            self._silent[servo_id] = 0
            self._prepare()

    def _judge(self, answered: set[int]) -> None:
        """Count the servos that are not in `answered` as silent, and prepare the next request.

        Where none answers, line or computer stalled, and no servo counts as silent.
        """
        for servo_id in self._span.ids:
            if servo_id in answered:
                self._silent[servo_id] = 0
            elif answered:
                self._silent[servo_id] = min(self._silent[servo_id] + 1, _ABSENT_AFTER)
        self._prepare()

    def _prepare(self, *, retry: bool = False) -> None:
        """Prepare the next request: silent servos last, long silent ones only if `retry`."""
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
