"""Transactions on one half-duplex line: ask, wait as long as the wire needs, take what came."""

import struct
from collections.abc import Callable, Sequence
from typing import Final, Protocol

from firmware_bridge.dynamixel import codec
from firmware_bridge.dynamixel.codec import BROADCAST_ID, MAX_ID, Instruction, Status, crc16
from firmware_bridge.dynamixel.frames import FrameParser
from firmware_bridge.dynamixel.latency import LearntLatency
from firmware_bridge.dynamixel.transport import Transport

BITS_PER_BYTE: Final = 10
#: Return delay of a servo fresh from the factory: 250 x 2 us.
FACTORY_RETURN_DELAY_S: Final = 0.0005
#: An int: looking a member up in its enumeration costs as much as comparing three.
_STATUS: Final = int(Instruction.STATUS)


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

    def is_over(self, stream: bytes) -> bool:
        """Whether nothing more can come: all bytes are there, or the servo asked last has spoken.

        On a half-duplex line nobody speaks after the last one, whoever was silent before.
        """
        if self.fast:
            return len(stream) >= self.reply_size and stream.startswith(codec.HEADER)
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

    def _take_fast(self, stream: bytes) -> list[Status] | None:
        """The common frame in one go, when its head, ids and last CRC are as they should be."""
        if stream[:8] != self._fast_head or stream[9 :: self.size + 4] != self._id_bytes:
            return None
        if crc16(stream[:-2]) != stream[-2] | stream[-1] << 8:
            return None
        blocks = self._blocks.iter_unpack(memoryview(stream)[8:])
        return [Status(servo_id, error, data) for error, servo_id, data in blocks]


class Line:
    """Master of the line. Nothing is sent before the computed end of the last transaction.

    Not thread-safe: one owner. Every method raises PortError when the port fails; a servo that
    does not answer is no error but a missing status.
    """

    def __init__(
        self, transport: Transport, return_delay_s: float = FACTORY_RETURN_DELAY_S
    ) -> None:
        """return_delay_s: the slowest servo's; it lengthens deadlines, not the wire."""
        self.transport = transport
        self.return_delay_s = return_delay_s
        self.byte_s = BITS_PER_BYTE / transport.baud_rate
        self.latency = LearntLatency()
        self.n_bad = 0
        self.heard_noise = False  # something came last time, but nothing that makes sense
        self._clock = transport.clock
        self._parser = FrameParser()
        self._quiet_s = 0.0  # from here on no reply is on the wire any more
        self._sent_s = 0.0  # here our own last byte is

    @property
    def baud_rate(self) -> int:
        """Bits a second on the wire."""
        return self.transport.baud_rate

    @baud_rate.setter
    def baud_rate(self, baud_rate: int) -> None:
        self.transport.baud_rate = baud_rate
        self.byte_s = BITS_PER_BYTE / baud_rate

    def ping(self, servo_id: int) -> Status | None:
        """Model number (2 bytes) and firmware version (1)."""
        return self._ask_one(servo_id, codec.ping(servo_id), 3)

    def ping_all(self) -> list[Status]:
        """Everybody there is, by one broadcast; takes 253 turns of 14 bytes.

        Two servos of one id spoil each other's answer: neither is in the list.
        """

        def take(stream: bytes, *, last: bool) -> list[Status] | None:
            return self._statuses(stream) if last else None

        n_bytes = (MAX_ID + 1) * (codec.EMPTY_STATUS_SIZE + 3)
        statuses = self._converse(codec.ping(BROADCAST_ID), n_bytes, take)
        return [status for status in statuses or () if len(status.data) == 3]

    def read(self, servo_id: int, address: int, size: int) -> Status | None:
        """`size` bytes of one servo."""
        return self._ask_one(servo_id, codec.read(servo_id, address, size), size)

    def write(
        self, servo_id: int, address: int, data: bytes, patience_s: float = 0.0
    ) -> Status | None:
        """Set bytes of one servo, and hear whether it took them; EEPROM may need patience."""
        return self._ask_one(servo_id, codec.write(servo_id, address, data), 0, patience_s)

    def reboot(self, servo_id: int) -> Status | None:
        """Restart one servo."""
        return self._ask_one(servo_id, codec.reboot(servo_id), 0)

    def tell(self, request: bytes) -> None:
        """Send what nobody answers: a sync write, or anything to everybody but a ping."""
        self._send(request)

    def sync_read(self, span: SpanRead) -> list[Status]:
        """The statuses that came, in the order asked; none is waited for beyond its time."""
        n = len(span.ids)

        def take(stream: bytes, *, last: bool) -> list[Status] | None:
            statuses = span.take_undisturbed(stream)
            if statuses is None:
                statuses = self._salvage(span, stream)
            return statuses if last or len(statuses) == n else None

        return self._converse(span.request, span.reply_size, take, span.is_over, n_turns=n) or []

    def _salvage(self, span: SpanRead, stream: bytes) -> list[Status]:
        """Whatever is whole in a disturbed stream."""
        if span.fast:
            start = stream.find(codec.HEADER)
            found = codec.split_fast_status(stream[start:], span.size) if start >= 0 else []
        else:
            found = [s for s in self._statuses(stream) if len(s.data) == span.size]
        by_id = {status.servo_id: status for status in found}
        return [by_id[each] for each in span.ids if each in by_id]

    def _ask_one(
        self, servo_id: int, request: bytes, n_data: int, patience_s: float = 0.0
    ) -> Status | None:
        def take(stream: bytes, *, last: bool) -> list[Status] | None:
            found = [
                status
                for status in self._statuses(stream)
                if status.servo_id == servo_id and (len(status.data) == n_data or status.error)
            ]
            return found[:1] if found or last else None

        size = codec.EMPTY_STATUS_SIZE if not n_data else codec.EMPTY_STATUS_SIZE + n_data
        found = self._converse(request, size, take, patience_s=patience_s)
        return found[0] if found else None

    def _send(self, request: bytes) -> float:
        """When the last byte will be on the wire; our own bytes queue up and need no waiting."""
        now_s = self._clock.now()
        if now_s < self._quiet_s:
            self._clock.sleep_until(self._quiet_s)
            now_s = self._clock.now()
        self.transport.write(request)
        begin_s = now_s if now_s > self._sent_s else self._sent_s
        self._sent_s = begin_s + len(request) * self.byte_s
        return self._sent_s

    def _converse(
        self,
        request: bytes,
        reply_size: int,
        take: "Take",
        is_over: Callable[[bytes], bool] = lambda _: False,
        *,
        n_turns: int = 1,
        patience_s: float = 0.0,
    ) -> list[Status] | None:
        """Send, then read until `take` is content or the time of the reply is over."""
        transport, clock = self.transport, self._clock
        transport.discard_input()
        due_s = self._send(request) + reply_size * self.byte_s
        wire_end_s = due_s + n_turns * self.return_delay_s
        deadline_s = wire_end_s + self.latency.slack_s + patience_s
        clock.sleep_until(due_s)
        stream = transport.read(deadline_s)
        while True:
            ended = is_over(stream)
            if ended or len(stream) >= reply_size:
                statuses = take(stream, last=ended)
                if statuses is not None:
                    self._quiet_s = clock.now()
                    self.latency.learn(self._quiet_s - due_s)
                    self.heard_noise = False
                    return statuses
            if stream and not patience_s:
                rest_s = max(wire_end_s, clock.now()) + self.latency.rest_slack_s
                deadline_s = min(deadline_s, rest_s)
            more = transport.read(deadline_s)
            if not more:
                self._quiet_s = max(wire_end_s, clock.now())
                statuses = take(stream, last=True)
                self.heard_noise = bool(stream) and not statuses
                return statuses
            stream += more

    def _statuses(self, stream: bytes) -> list[Status]:
        self._parser.reset()
        n_bad = self._parser.n_bad
        statuses = [
            Status(frame.packet_id, frame.parameters[0], frame.parameters[1:])
            for frame in self._parser.feed(stream)
            if frame.instruction == _STATUS and frame.parameters
        ]
        self.n_bad += self._parser.n_bad - n_bad
        return statuses


class Take(Protocol):
    """Makes statuses of a stream; None while it wants more, never when `last`."""

    def __call__(self, stream: bytes, *, last: bool) -> list[Status] | None:
        """Take what can be taken."""
