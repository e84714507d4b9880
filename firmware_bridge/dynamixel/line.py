"""Questions to servos, and their answers, on one half-duplex line."""

import struct
from collections.abc import Sequence
from typing import Final

from firmware_bridge.dynamixel import codec
from firmware_bridge.dynamixel.codec import BROADCAST_ID, MAX_ID, Instruction, Status, crc16
from firmware_bridge.dynamixel.half_duplex import HalfDuplex
from firmware_bridge.dynamixel.owed import ANYBODY, OwedAnswers
from firmware_bridge.dynamixel.transport import Transport

#: Return delay of a servo fresh from the factory: 250 x 2 us.
FACTORY_RETURN_DELAY_S: Final = 0.0005
#: An int: looking a member up in its enumeration costs as much as comparing three.
_STATUS: Final = int(Instruction.STATUS)
#: What a ping is answered with: model number (2 bytes), firmware version (1). The same bytes lie at
#: 0 and 6 of every control table.
_PONG_SIZE: Final = 3
_IDENTITY_SIZE: Final = 7


class GoalWrite:
    """A prepared sync write of one four-byte register of several servos."""

    def __init__(self, ids: Sequence[int], address: int) -> None:
        self._flat = [each for servo_id in ids for each in (servo_id, 0)]
        self._pack = struct.Struct("<" + "Bi" * len(ids)).pack
        parameters = struct.pack("<HH", address, 4)
        length = len(parameters) + 5 * len(ids) + 3
        head = struct.pack("<BHB", BROADCAST_ID, length, Instruction.SYNC_WRITE)
        self._head = codec.HEADER + head + parameters
        self._address = address

    def request(self, values: Sequence[int]) -> bytes:
        """The packet that sets these values, one a servo, in the order of the ids."""
        self._flat[1::2] = values
        blocks = self._pack(*self._flat)
        if b"\xff\xff\xfd" in blocks:
            parameters = self._head[8:] + blocks
            return codec.packet(BROADCAST_ID, Instruction.SYNC_WRITE, parameters)
        raw = self._head + blocks
        return raw + crc16(raw).to_bytes(2, "little")


class SpanRead:
    """A prepared question to several servos for the same `size` bytes from `address` on."""

    def __init__(self, ids: Sequence[int], address: int, size: int, *, fast: bool) -> None:
        self.ids = tuple(ids)
        self.address = address
        self.size = size
        self.fast = fast
        self.request = codec.sync_read(self.ids, address, size, fast=fast)
        self._step = size + codec.EMPTY_STATUS_SIZE
        self._heads = [
            codec.HEADER + struct.pack("<BHB", each, size + 4, Instruction.STATUS)
            for each in self.ids
        ]
        n = len(self.ids)
        length = 1 + n * (size + 4)
        self._fast_head = codec.HEADER + struct.pack("<BHB", BROADCAST_ID, length, _STATUS)
        self._blocks = struct.Struct(f"<BB{size}s2x")  # error, id, data, inner CRC
        self._id_bytes = bytes(self.ids)
        self.reply_size = codec.EMPTY_PACKET_SIZE - 2 + n * (size + 4) if fast else n * self._step
        self._wider: dict[int, SpanRead] = {}

    def widened(self, size: int) -> "SpanRead":
        """The same question for `size` bytes, the further ones before its own where there are such.

        Every control table begins at 0; where it ends differs.
        """
        if size not in self._wider:
            more = size - self.size
            address = self.address - more if self.address >= more else self.address
            self._wider[size] = SpanRead(self.ids, address, size, fast=self.fast)
        return self._wider[size]

    def cut(self, status: Status, address: int) -> Status:
        """Our own bytes of an answer that begins at `address`."""
        at = self.address - address
        return status._replace(data=status.data[at : at + self.size])

    def is_over(self, stream: bytes) -> bool:
        """Whether nothing more can come: all bytes are there, or the servo asked last has spoken.

        On a half-duplex line nobody speaks after the last one, whoever was silent before.
        """
        if self.fast:
            return len(stream) >= self.reply_size and stream.startswith(self._fast_head)
        return stream[-self._step : 8 - self._step] == self._heads[-1]

    def take_undisturbed(self, stream: bytes) -> list[Status] | None:
        """All statuses when `stream` is exactly what was asked for; None when anything differs."""
        if len(stream) != self.reply_size:
            return None
        if self.fast:
            return self._take_fast(stream)
        statuses = []
        at, step = 0, self._step
        for servo_id, head in zip(self.ids, self._heads, strict=True):
            end = at + step
            if stream[at : at + 8] != head:
                return None
            if crc16(stream[at : end - 2]) != stream[end - 2] | stream[end - 1] << 8:
                return None
            data = stream[at + 9 : end - 2]
            if b"\xff\xff\xfd\xfd" in data:
                return None
            statuses.append(Status(servo_id, stream[at + 8], data))
            at = end
        return statuses

    def salvage_fast(self, stream: bytes) -> list[Status]:
        """The parts of a disturbed common frame that arrived whole."""
        start = stream.find(self._fast_head)
        if start < 0:
            return []
        found = codec.split_fast_status(stream[start : start + self.reply_size], self.size)
        return [
            status
            for status, asked in zip(found, self.ids, strict=False)
            if status.servo_id == asked
        ]

    def _take_fast(self, stream: bytes) -> list[Status] | None:
        """The common frame in one go, when its head, ids and last CRC are as they should be."""
        if stream[:8] != self._fast_head or stream[9 :: self.size + 4] != self._id_bytes:
            return None
        if crc16(stream[:-2]) != stream[-2] | stream[-1] << 8:
            return None
        blocks = self._blocks.iter_unpack(memoryview(stream)[8:])
        return [Status(servo_id, error, data) for error, servo_id, data in blocks]


class Line(HalfDuplex):
    """Master of the line. No answer counts that could be the late one to another question.

    Not thread-safe: one owner. Every method raises PortError when the port fails; a servo that
    does not answer is no error but a missing status.
    """

    def __init__(
        self, transport: Transport, return_delay_s: float = FACTORY_RETURN_DELAY_S
    ) -> None:
        """return_delay_s: the slowest servo's; it lengthens deadlines, not the wire."""
        super().__init__(transport, return_delay_s)
        self._owed = OwedAnswers()

    def ping(self, servo_id: int) -> Status | None:
        """Model number (2 bytes) and firmware version (1)."""
        request = codec.ping(servo_id)
        if self._owes() and self._owed.looks_like(servo_id, _PONG_SIZE, request):
            status = self.read(servo_id, 0, _IDENTITY_SIZE)
            if status is None or len(status.data) != _IDENTITY_SIZE:
                return None
            return status._replace(data=status.data[:2] + status.data[-1:])
        return self._ask_one(servo_id, request, _PONG_SIZE)

    def ping_all(self) -> list[Status]:
        """Everybody there is, by one broadcast; takes 253 turns of 14 bytes.

        Two servos of one id spoil each other's answer: neither is in the list.
        """

        def take(stream: bytes, *, last: bool) -> list[Status] | None:
            return self._statuses(stream) if last else None

        self._wait_for_owed()
        request = codec.ping(BROADCAST_ID)
        n_bytes = (MAX_ID + 1) * (codec.EMPTY_STATUS_SIZE + _PONG_SIZE)
        statuses = self._converse(request, n_bytes, take)
        self._owed.note(ANYBODY, _PONG_SIZE, request, self._clock.now())
        return [status for status in statuses if len(status.data) == _PONG_SIZE]

    def read(self, servo_id: int, address: int, size: int) -> Status | None:
        """`size` bytes of one servo."""
        if self._owes():
            span = SpanRead((servo_id,), address, size, fast=False)
            wide = span.widened(self._owed.free_size(span.ids, size))
            request = codec.read(servo_id, wide.address, wide.size)
            status = self._ask_one(servo_id, request, wide.size, exact=True)
            return None if status is None else span.cut(status, wide.address)
        return self._ask_one(servo_id, codec.read(servo_id, address, size), size)

    def write(
        self, servo_id: int, address: int, data: bytes, patience_s: float = 0.0
    ) -> Status | None:
        """Set bytes of one servo, and hear whether it took them; EEPROM may need patience."""
        request = codec.write(servo_id, address, data)
        if self._acknowledgement_is_ambiguous(servo_id, request):
            self._tell_one(servo_id, request, patience_s)
            status = self.read(servo_id, address, len(data))
            return status._replace(data=b"") if status is not None and status.data == data else None
        return self._ask_one(servo_id, request, 0, patience_s)

    def reboot(self, servo_id: int) -> Status | None:
        """Restart one servo. None also when its answer could not be told from another."""
        request = codec.reboot(servo_id)
        if self._acknowledgement_is_ambiguous(servo_id, request):
            self._tell_one(servo_id, request, 0.0)
            return None
        return self._ask_one(servo_id, request, 0)

    def tell(self, request: bytes) -> None:
        """Send what nobody answers: a sync write, or anything to everybody but a ping."""
        self._send(request)

    def sync_read(self, span: SpanRead) -> list[Status]:
        """The statuses that came, in the order asked; none is waited for beyond its time."""
        if not self._owes():
            return self._ask_span(span)
        if span.fast:
            step = len(span.ids)
            n_bytes = self._owed.free_size((BROADCAST_ID,), span.reply_size, step)
            wide = span.widened(span.size + (n_bytes - span.reply_size) // step)
        else:
            wide = span.widened(self._owed.free_size(span.ids, span.size))
        return [span.cut(status, wide.address) for status in self._ask_span(wide)]

    def _ask_span(self, span: SpanRead) -> list[Status]:
        n = len(span.ids)

        def take(stream: bytes, *, last: bool) -> list[Status] | None:
            statuses = span.take_undisturbed(stream)
            if statuses is None:
                statuses = self._salvage(span, stream)
            return statuses if last or len(statuses) == n else None

        statuses = self._converse(span.request, span.reply_size, take, span.is_over, n_turns=n)
        if len(statuses) != n:
            self._note_missing(span, statuses)
        return statuses

    def _salvage(self, span: SpanRead, stream: bytes) -> list[Status]:
        """Whatever is whole in a disturbed stream."""
        if span.fast:
            return span.salvage_fast(stream)
        by_id = {s.servo_id: s for s in self._statuses(stream) if len(s.data) == span.size}
        return [by_id[each] for each in span.ids if each in by_id]

    def _note_missing(self, span: SpanRead, statuses: list[Status]) -> None:
        """Who of those asked may answer yet; a common frame comes as a whole."""
        now_s = self._clock.now()
        if span.fast:
            self._owed.note(BROADCAST_ID, span.reply_size, span.request, now_s)
            return
        for servo_id in {*span.ids} - {status.servo_id for status in statuses}:
            self._owed.note(servo_id, span.size, span.request, now_s)

    def _ask_one(
        self,
        servo_id: int,
        request: bytes,
        n_data: int,
        patience_s: float = 0.0,
        *,
        exact: bool = False,
    ) -> Status | None:
        """exact: a refusal does not count either, for it may be owed by an earlier question."""
        size = codec.EMPTY_STATUS_SIZE + n_data

        def take(stream: bytes, *, last: bool) -> list[Status] | None:
            if len(stream) == size:
                status = codec.undisturbed_status(stream)
                if status is not None and status.servo_id == servo_id:
                    return [status]
            found = [
                status
                for status in self._statuses(stream)
                if status.servo_id == servo_id
                and (len(status.data) == n_data or (status.error & 0x7F and not exact))
            ]
            return found[:1] if found or last else None

        found = self._converse(request, size, take, patience_s=patience_s)
        if not found:
            self._owed.note(servo_id, n_data, request, self._clock.now())
            return None
        return found[0]

    def _owes(self) -> bool:
        return self._owed.any and self._owed.expire(self._clock.now())

    def _acknowledgement_is_ambiguous(self, servo_id: int, request: bytes) -> bool:
        """All acknowledgements look alike; one for the same bytes, written again, is as good."""
        if self.patience_s:
            self._wait_for_owed()
        return self._owes() and self._owed.looks_like(servo_id, 0, request)

    def _tell_one(self, servo_id: int, request: bytes, patience_s: float) -> None:
        """Send, and leave the line to whatever it is answered with."""
        sent_s = self._send(request)
        answer_s = codec.EMPTY_STATUS_SIZE * self.byte_s + self.return_delay_s + patience_s
        self._quiet_s = sent_s + answer_s
        self._owed.note(servo_id, 0, request, sent_s)

    def _wait_for_owed(self) -> None:
        """Until nothing can come any more; for what is in no hurry."""
        if self._owes():
            self._clock.sleep_until(self._owed.until_s)
            self._owed.expire(self._clock.now())
