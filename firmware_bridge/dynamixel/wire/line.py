"""One line of Dynamixels: requests to servos and their answers."""

from collections.abc import Sequence
from typing import Final

from firmware_bridge.dynamixel.wire import codec
from firmware_bridge.dynamixel.wire.codec import (
    BROADCAST_ID,
    MAX_ID,
    FrameParser,
    Instruction,
    SpanRead,
    Status,
)
from firmware_bridge.serial_servos.half_duplex import ANYBODY, HalfDuplex
from firmware_bridge.transport import Transport

#: An int: looking a member up in its enumeration costs as much as comparing three.
_STATUS: Final = int(Instruction.STATUS)


#: Return delay of a servo fresh from the factory: 250 x 2 us.
FACTORY_RETURN_DELAY_S: Final = 0.0005
#: Data of the answer to a ping: model number (2 bytes), firmware version (1). The same bytes are at
#: addresses 0 and 6 of every control table.
_PONG_SIZE: Final = 3
_IDENTITY_SIZE: Final = 7


class Line(HalfDuplex):
    """The computer's side of a line of Dynamixels: sends requests and returns the answers.

    Answers that may be late ones to earlier requests do not count. n_bad: damaged packets received.
    """

    def __init__(
        self,
        transport: Transport,
        return_delay_s: float = FACTORY_RETURN_DELAY_S,
        *,
        extra_wait_s: float = 0.0,
    ) -> None:
        """Use the line behind `transport`, an open port; parameters as those of `HalfDuplex`."""
        super().__init__(transport, return_delay_s, extra_wait_s)
        self.n_bad = 0
        self._parser = FrameParser()

    def ping(self, servo_id: int, extra_wait_s: float = 0.0) -> Status | None:
        """Ping one servo; return model number (2 bytes) and firmware version (1); None: silent.

        extra_wait_s: how long to wait beyond the deadline. Where a late answer could be mistaken
        for that to the ping, the same values are read from registers instead.
        """
        request = codec.ping(servo_id)
        if self._has_pending() and self._pending.looks_like(servo_id, _PONG_SIZE, request):
            status = self.read(servo_id, 0, _IDENTITY_SIZE, extra_wait_s)
            if status is None or len(status.data) != _IDENTITY_SIZE:
                return None
            return status._replace(data=status.data[:2] + status.data[-1:])
        return self._ask_one(servo_id, request, _PONG_SIZE, extra_wait_s)

    def ping_each(self, servo_id: int) -> list[Status]:
        """Send one ping and return every answer; two servos with one id may both answer.

        Waits for the time of two answers. May first wait until no late answer can come.
        """
        if self._has_pending() and self._pending.free_size((servo_id,), _PONG_SIZE) != _PONG_SIZE:
            self._wait_for_pending()
        request = codec.ping(servo_id)
        n_bytes = 2 * (codec.EMPTY_STATUS_SIZE + _PONG_SIZE)
        take, wait_s = self._at_the_end, FACTORY_RETURN_DELAY_S
        statuses = self._transact(request, n_bytes, take, extra_wait_s=wait_s) or []
        if not statuses:
            self._pending.note(servo_id, _PONG_SIZE, request, self._clock.now())
        return [s for s in statuses if s.servo_id == servo_id and len(s.data) == _PONG_SIZE]

    def ping_all(self) -> list[Status]:
        """Broadcast a ping and return every answer; takes the time of 253 answers of 14 bytes.

        Answers of two servos with one id collide: neither is in the list.
        """
        self._wait_for_pending()
        request = codec.ping(BROADCAST_ID)
        n_bytes = (MAX_ID + 1) * (codec.EMPTY_STATUS_SIZE + _PONG_SIZE)
        statuses = self._transact(request, n_bytes, self._at_the_end) or []
        self._pending.note(ANYBODY, _PONG_SIZE, request, self._clock.now())
        return [status for status in statuses if len(status.data) == _PONG_SIZE]

    def read(
        self, servo_id: int, address: int, size: int, extra_wait_s: float = 0.0
    ) -> Status | None:
        """Read `size` bytes of one servo from `address` on; None: no answer.

        extra_wait_s: how long to wait beyond the deadline. While a late answer of this size may
        still come, more bytes are read than requested, so that the answers differ in size.
        """
        if self._pending.any and self._has_pending():
            span = SpanRead((servo_id,), address, size, fast=False)
            wide = span.widened(self._pending.free_size(span.ids, size))
            request = codec.read(servo_id, wide.address, wide.size)
            status = self._ask_one(servo_id, request, wide.size, extra_wait_s, exact=True)
            return None if status is None else span.cut([status], wide.address)[0]
        return self._ask_one(servo_id, codec.read(servo_id, address, size), size, extra_wait_s)

    def write(
        self, servo_id: int, address: int, data: bytes, extra_wait_s: float = 0.0
    ) -> Status | None:
        """Write bytes of one servo from `address` on and return its status; None: not confirmed.

        extra_wait_s: how long to wait beyond the deadline, as EEPROM may need. Where a late
        acknowledgement could be mistaken for that of this write, the bytes are read back instead.
        """
        request = codec.write(servo_id, address, data)
        if self._acknowledgement_is_ambiguous(servo_id, request):
            self._tell_one(servo_id, request, extra_wait_s)
            status = self.read(servo_id, address, len(data))
            return status._replace(data=b"") if status is not None and status.data == data else None
        return self._ask_one(servo_id, request, 0, extra_wait_s)

    def reboot(self, servo_id: int) -> Status | None:
        """Restart one servo; return its status; None: none came, or it is ambiguous.

        A late acknowledgement of an earlier request looks like that of the restart.
        """
        request = codec.reboot(servo_id)
        if self._acknowledgement_is_ambiguous(servo_id, request):
            self._tell_one(servo_id, request, 0.0)
            return None
        return self._ask_one(servo_id, request, 0)

    def sync_read(self, span: SpanRead) -> Sequence[Status]:
        """Send request `span`; return the statuses that came in time, in the order of its ids.

        While late answers of the same size may still come, more bytes are read than `span` has, and
        the statuses cut to its bytes.
        """
        if not (self._pending.any and self._has_pending()):
            return self._ask_span(span)
        if span.fast:
            n, frame = len(span.ids), span.answer_size
            wider = self._pending.free_size((BROADCAST_ID,), frame, step=n)
            wide = span.widened(span.size + (wider - frame) // n)
        else:
            wide = span.widened(self._pending.free_size(span.ids, span.size))
        statuses = self._ask_span(wide)
        return statuses if wide.size == span.size else span.cut(statuses, wide.address)

    def _ask_span(self, span: SpanRead) -> Sequence[Status]:
        """Send request `span` as it is; return the statuses that came, in the order of its ids.

        Servos that did not answer in time are noted: their answers may still come.
        """
        n = len(span.ids)

        def take(stream: bytes, *, last: bool) -> Sequence[Status] | None:
            """Return all statuses, or if no more bytes come those that are whole; None: read on."""
            whole = span.take_undisturbed(stream)
            if whole is not None:
                return whole
            statuses = self._salvage(span, stream)
            return statuses if last or len(statuses) == n else None

        statuses = (
            self._transact(span.request, span.reply_size, take, span.is_over, n_answers=n) or []
        )
        if self._pending.any:
            self._note_late(self._heard, requested_size=span.answer_size)
        if len(statuses) != n:
            self._note_missing(span, statuses)
        return statuses

    def _salvage(self, span: SpanRead, stream: bytes) -> list[Status]:
        """Return the statuses that are whole in a disturbed stream, in the span's order."""
        if span.fast:
            return span.salvage_fast(stream)
        by_id = {s.servo_id: s for s in self._statuses(stream) if len(s.data) == span.size}
        return [by_id[each] for each in span.ids if each in by_id]

    def _note_missing(self, span: SpanRead, statuses: Sequence[Status]) -> None:
        """Note that the servos of `span` without a status may still answer late.

        statuses: those that came. The frame that answers a fast read comes late as a whole.
        """
        now_s = self._clock.now()
        if span.fast:
            self._pending.note(BROADCAST_ID, span.answer_size, span.request, now_s)
            return
        for servo_id in {*span.ids} - {status.servo_id for status in statuses}:
            self._pending.note(servo_id, span.size, span.request, now_s)

    def _ask_one(
        self,
        servo_id: int,
        request: bytes,
        n_data: int,
        extra_wait_s: float = 0.0,
        *,
        exact: bool = False,
    ) -> Status | None:
        """Send a request; return the status with `n_data` bytes or an error; None: none in time.

        exact: a status with an error does not count either, since it may answer an earlier request.
        """
        size = codec.EMPTY_STATUS_SIZE + n_data

        def take(stream: bytes, *, last: bool) -> list[Status] | None:
            """Return [status] for a fitting status in `stream`; None: read on; []: none came."""
            if len(stream) == size:
                status = codec.undisturbed_status(stream)
                if status is not None and status.servo_id == servo_id:
                    return [status]
            # An error status has no data; 0x7F: the error number without the alert bit.
            found = [
                status
                for status in self._statuses(stream)
                if status.servo_id == servo_id
                and (len(status.data) == n_data or (status.error & 0x7F and not exact))
            ]
            return found[:1] if found or last else None

        found = self._transact(request, size, take, extra_wait_s=extra_wait_s)
        if self._pending.any:
            self._note_late(self._heard, requested_size=n_data)
        if not found:
            self._pending.note(servo_id, n_data, request, self._clock.now())
            return None
        return found[0]

    def _has_pending(self) -> bool:
        """Return whether late answers may still come, after discarding those that have arrived."""
        if not self._pending.any:
            return False
        self._note_late(self.transport.discard_input(), requested_size=None)
        return self._pending.expire(self._clock.now())

    def _note_late(self, stream: bytes, requested_size: int | None) -> None:
        """Remove from the pending answers the late ones that are in the bytes `stream`.

        requested_size: data bytes of the answer to the newest request, which is not late; None:
        every answer is late.
        """
        for status in self._statuses(stream):
            if len(status.data) != requested_size:
                self._pending.note_arrived(status.servo_id, len(status.data))

    def _acknowledgement_is_ambiguous(self, servo_id: int, request: bytes) -> bool:
        """Return whether a late acknowledgement may be mistaken for that of the write `request`.

        All acknowledgements of a servo look alike; a late one of the same request does no harm. On
        a line with `extra_wait_s` this waits until no late answer can come.
        """
        if self.extra_wait_s:
            self._wait_for_pending()
        return self._has_pending() and self._pending.looks_like(servo_id, 0, request)

    def _tell_one(self, servo_id: int, request: bytes, extra_wait_s: float) -> None:
        """Send a request, read no answer, and keep the line quiet while an answer may come."""
        sent_s = self._send(request)
        answer_s = codec.EMPTY_STATUS_SIZE * self.byte_s + self.return_delay_s + extra_wait_s
        self._quiet_s = sent_s + answer_s
        self._pending.note(servo_id, 0, request, sent_s)

    def _wait_for_pending(self) -> None:
        """Sleep until no late answer can come any more; for commands outside the loop."""
        if self._has_pending():
            self._clock.sleep_until(self._pending.until_s)
            self._pending.expire(self._clock.now())

    def _at_the_end(self, stream: bytes, *, last: bool) -> list[Status] | None:
        return self._statuses(stream) if last else None

    def _statuses(self, stream: bytes) -> list[Status]:
        """Return every whole status packet in a stream, skipping all other bytes."""
        self._parser.reset()
        n_bad = self._parser.n_bad
        statuses = [
            Status(frame.packet_id, frame.parameters[0], frame.parameters[1:])
            for frame in self._parser.feed(stream)
            if frame.instruction == _STATUS and frame.parameters
        ]
        self.n_bad += self._parser.n_bad - n_bad
        return statuses
