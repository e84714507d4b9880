"""Packets prepared once and used in every tick: one question to many servos, goals for all."""

import struct
from collections.abc import Iterator, Sequence
from typing import Final, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from firmware_bridge.dynamixel.wire import codec
from firmware_bridge.dynamixel.wire.codec import BROADCAST_ID, Instruction, Status, crc16

#: An int: looking a member up in its enumeration costs as much as comparing three.
_STATUS: Final = int(Instruction.STATUS)
#: Where the first servo's block begins in a common frame.
_BLOCKS_AT: Final = 8


class GoalWrite:
    """A prepared sync write of one four-byte register of several servos."""

    def __init__(self, ids: Sequence[int], address: int) -> None:
        self._blocks = np.zeros(len(ids), dtype=[("id", "u1"), ("value", "<i4")])
        self._blocks["id"] = ids
        self._values = self._blocks["value"]
        parameters = struct.pack("<HH", address, 4)
        length = len(parameters) + 5 * len(ids) + 3
        head = struct.pack("<BHB", BROADCAST_ID, length, Instruction.SYNC_WRITE)
        self._head = codec.HEADER + head + parameters

    def request(self, values: ArrayLike) -> bytes:
        """The packet that sets these whole numbers, one a servo, in the order of the ids."""
        self._values[:] = values
        blocks = self._blocks.tobytes()
        if b"\xff\xff\xfd" in blocks:
            parameters = self._head[8:] + blocks
            return codec.packet(BROADCAST_ID, Instruction.SYNC_WRITE, parameters)
        raw = self._head + blocks
        return raw + crc16(raw).to_bytes(2, "little")


class CommonFrame(Sequence[Status]):
    """An undisturbed answer of all who were asked, in one frame.

    Statuses are made when somebody wants them one by one; `values` has all of them at once.
    errors: a byte of each servo, in turn.
    """

    def __init__(self, ids: tuple[int, ...], size: int, stream: bytes) -> None:
        """stream: checked by the caller."""
        self.ids = ids
        self.stream = stream
        self.errors = stream[_BLOCKS_AT :: size + 4]
        self._size = size

    @staticmethod
    def size_of(n_servos: int, size: int) -> int:
        """Bytes of the whole frame of so many servos, of `size` bytes each."""
        return _BLOCKS_AT + n_servos * (size + 4)

    @staticmethod
    def block_of(data: np.dtype[np.void]) -> np.dtype[np.void]:
        """What a servo's part of the frame looks like, when its bytes look like `data`."""
        return np.dtype([("error", "u1"), ("id", "u1"), *data.descr, ("crc", "<u2")])

    def values(self, block: np.dtype[np.void]) -> NDArray[np.void]:
        """The fields of all servos, (n_servos,), in the order asked. block: of `block_of`."""
        return self.blocks(self.stream, block)

    @staticmethod
    def blocks(stream: bytes | bytearray, block: np.dtype[np.void]) -> NDArray[np.void]:
        """The same of any memory that holds, or will hold, such a frame."""
        return np.frombuffer(stream, dtype=block, offset=_BLOCKS_AT)

    def __len__(self) -> int:
        return len(self.ids)

    @overload
    def __getitem__(self, at: int) -> Status: ...
    @overload
    def __getitem__(self, at: slice) -> list[Status]: ...
    def __getitem__(self, at: int | slice) -> Status | list[Status]:
        return [*self][at]

    def __iter__(self) -> Iterator[Status]:
        start = _BLOCKS_AT + 2
        for servo_id, error in zip(self.ids, self.errors, strict=True):
            yield Status(servo_id, error, self.stream[start : start + self._size])
            start += self._size + 4


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
        self._id_bytes = bytes(self.ids)
        self.reply_size = codec.EMPTY_PACKET_SIZE - 2 + n * (size + 4) if fast else n * self._step
        #: Bytes in the status packet that answers: of one servo, or the common frame of all.
        self.answer_size = self.reply_size - codec.EMPTY_STATUS_SIZE if fast else size
        self._wider: dict[int, SpanRead] = {}

    def widened(self, size: int) -> "SpanRead":
        """The same question for `size` bytes, the further ones before its own where there are such.

        Every control table begins at 0; where it ends differs.
        """
        if size == self.size:
            return self
        if size not in self._wider:
            more = size - self.size
            address = self.address - more if self.address >= more else self.address
            self._wider[size] = SpanRead(self.ids, address, size, fast=self.fast)
        return self._wider[size]

    def cut(self, statuses: Sequence[Status], address: int) -> list[Status]:
        """Our own bytes of answers that begin at `address`."""
        own = slice(self.address - address, self.address - address + self.size)
        return [Status(each.servo_id, each.error, each.data[own]) for each in statuses]

    def is_over(self, stream: bytes) -> bool:
        """Whether nothing more can come: all bytes are there, or the servo asked last has spoken.

        On a half-duplex line nobody speaks after the last one, whoever was silent before.
        """
        if self.fast:
            return len(stream) >= self.reply_size and stream.startswith(self._fast_head)
        return stream[-self._step : 8 - self._step] == self._heads[-1]

    def take_undisturbed(self, stream: bytes) -> Sequence[Status] | None:
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

    def _take_fast(self, stream: bytes) -> CommonFrame | None:
        """The common frame in one go, when its head, ids and last CRC are as they should be."""
        if stream[:8] != self._fast_head or stream[9 :: self.size + 4] != self._id_bytes:
            return None
        if crc16(stream[:-2]) != stream[-2] | stream[-1] << 8:
            return None
        return CommonFrame(self.ids, self.size, stream)
