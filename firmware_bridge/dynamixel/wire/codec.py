"""Protocol 2.0 packets as bytes: made, found in a stream, or prepared once for every tick.

https://emanual.robotis.com/docs/en/dxl/protocol2/

    FF FF FD 00 | id | length, 2 bytes | instruction | parameters | CRC-16, 2 bytes

length counts everything after itself. Inside instruction and parameters `FF FF FD` is sent as
`FF FF FD FD` (stuffing), so that a header never appears within a packet. The CRC covers the stuffed
bytes. All numbers are little-endian.
"""

import struct
from collections.abc import Iterable, Iterator, Sequence
from enum import IntEnum
from functools import lru_cache
from typing import Final, NamedTuple, overload

import numpy as np
from fastcrc import crc16 as _crc16
from numpy.typing import ArrayLike, NDArray

HEADER: Final = b"\xff\xff\xfd\x00"
#: x^16 + x^15 + x^2 + 1, start 0, not reflected: what Dynamixel calls CRC-16 (IBM/ANSI).
crc16 = _crc16.umts
_PATTERN: Final = b"\xff\xff\xfd"
_STUFFED: Final = b"\xff\xff\xfd\xfd"
_STATUS_HEAD: Final = struct.Struct("<HB")
#: Bytes of a packet without parameters.
EMPTY_PACKET_SIZE: Final = 10
#: Bytes of a status packet without data: one more, the error.
EMPTY_STATUS_SIZE: Final = 11
BROADCAST_ID: Final = 254
#: The largest id a servo may have: https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/#id
MAX_ID: Final = 252
#: No packet is longer than this: the answer to a fast sync read of 252 servos, 40 bytes each. A
#: larger value in a length field is noise, and the parser waits for no such packet.
MAX_LENGTH: Final = 12_000
#: Added to the error number while a servo's hardware_error_status is not 0.
ALERT_BIT: Final = 0x80


class Instruction(IntEnum):
    """Instructions: https://emanual.robotis.com/docs/en/dxl/protocol2/#instruction ."""

    PING = 0x01
    READ = 0x02
    WRITE = 0x03
    REG_WRITE = 0x04
    ACTION = 0x05
    FACTORY_RESET = 0x06
    REBOOT = 0x08
    CLEAR = 0x10
    BACKUP = 0x20
    STATUS = 0x55
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83
    FAST_SYNC_READ = 0x8A
    BULK_READ = 0x92
    BULK_WRITE = 0x93
    FAST_BULK_READ = 0x9A


class StatusError(IntEnum):
    """Error numbers: https://emanual.robotis.com/docs/en/dxl/protocol2/#error ."""

    NONE = 0
    RESULT_FAIL = 1
    INSTRUCTION = 2
    CRC = 3
    DATA_RANGE = 4
    DATA_LENGTH = 5
    DATA_LIMIT = 6
    ACCESS = 7


class Status(NamedTuple):
    """The answer of one servo. error: a `StatusError`, plus `ALERT_BIT` after a hardware error.

    data: the bytes that were read; empty in an acknowledgement.
    """

    servo_id: int
    error: int
    data: bytes


def stuff(body: bytes) -> bytes:
    """Return `body` with FF FF FD replaced by FF FF FD FD, so that it contains no header."""
    return body.replace(_PATTERN, _STUFFED)


def unstuff(body: bytes) -> bytes:
    """Return `body` without the bytes that `stuff` inserted."""
    return body.replace(_STUFFED, _PATTERN)


def packet(packet_id: int, instruction: int, parameters: bytes = b"") -> bytes:
    """Return a whole packet to or from servo `packet_id`, stuffed and with its CRC.

    Raises ValueError when the parameters do not fit: the length field counts to 65,535.
    """
    body = stuff(parameters)
    length = len(body) + 3
    if length > 0xFFFF:
        raise ValueError(f"{len(parameters)} bytes of parameters are too many for one packet")
    head = HEADER + struct.pack("<BHB", packet_id, length, instruction) + body
    return head + crc16(head).to_bytes(2, "little")


def ping(servo_id: int) -> bytes:
    """Return the request for model number and firmware; `BROADCAST_ID` addresses all servos."""
    return packet(servo_id, Instruction.PING)


@lru_cache(maxsize=1024)
def read(servo_id: int, address: int, size: int) -> bytes:
    """Return the request for `size` bytes of one servo from `address` on.

    Cached, since a tick sends it often.
    """
    return packet(servo_id, Instruction.READ, struct.pack("<HH", address, size))


def write(servo_id: int, address: int, data: bytes) -> bytes:
    """Return the packet that sets bytes of one servo from `address` on; `BROADCAST_ID`: of all."""
    return packet(servo_id, Instruction.WRITE, struct.pack("<H", address) + data)


def reboot(servo_id: int) -> bytes:
    """Return the packet that restarts a servo, which also clears its hardware error."""
    return packet(servo_id, Instruction.REBOOT)


def sync_read(ids: Sequence[int], address: int, size: int, *, fast: bool = False) -> bytes:
    """Return the request to several servos for `size` bytes each from `address` on.

    They answer in the order of ids. fast: in one common frame instead of one frame each.
    """
    instruction = Instruction.FAST_SYNC_READ if fast else Instruction.SYNC_READ
    return packet(BROADCAST_ID, instruction, struct.pack("<HH", address, size) + bytes(ids))


def sync_write(address: int, size: int, data: Iterable[tuple[int, bytes]]) -> bytes:
    """Return the packet that sets `size` bytes of several servos from `address` on.

    data: (id, bytes) of each servo. No servo answers the packet.
    """
    blocks = b"".join(bytes((servo_id,)) + each for servo_id, each in data)
    parameters = struct.pack("<HH", address, size) + blocks
    return packet(BROADCAST_ID, Instruction.SYNC_WRITE, parameters)


def status(servo_id: int, error: int = 0, data: bytes = b"") -> bytes:
    """Return the status packet of a servo; for the simulator."""
    return packet(servo_id, Instruction.STATUS, bytes((error,)) + data)


def undisturbed_status(raw: bytes) -> Status | None:
    """Return the status in `raw`, exactly one valid packet without stuffing; None for all else."""
    size = len(raw) - 7
    if raw[:4] != HEADER or raw[5:8] != _STATUS_HEAD.pack(size, Instruction.STATUS):
        return None
    if crc16(raw[:-2]) != raw[-2] | raw[-1] << 8 or _STUFFED in raw:
        return None
    return Status(raw[4], raw[8], raw[9:-2])


def fast_status(blocks: Sequence[tuple[int, int, bytes]]) -> bytes:
    """Return the common frame that answers a fast sync read, from (id, error, data) of each servo.

    Parsed by position and therefore not stuffed; each servo's block ends in the CRC of all bytes
    before. For the simulator.
    """
    length = 1 + sum(4 + len(data) for _, _, data in blocks)
    frame = bytearray(HEADER + struct.pack("<BHB", BROADCAST_ID, length, Instruction.STATUS))
    for servo_id, error, data in blocks:
        frame += bytes((error, servo_id)) + data
        frame += crc16(bytes(frame)).to_bytes(2, "little")
    return bytes(frame)


def split_fast_status(frame: bytes, size: int) -> list[Status]:
    """Return the statuses in the common frame of a fast sync read of `size` bytes each.

    `frame` may be cut off: blocks that arrived whole and whose own CRC is right are returned. When
    the frame's last CRC is right, all its blocks count, whatever the inner CRCs are: whether real
    servos send them cumulative, as here, is not verified on hardware.
    """
    # A block: error, id, data, CRC. declared: bytes of the whole frame by its length field.
    step = size + 4
    declared = int.from_bytes(frame[5:7], "little") + 7
    whole = len(frame) >= declared and _crc_holds(frame[:declared])
    statuses = []
    for end in range(8 + step, min(len(frame), declared) + 1, step):
        block = frame[end - step : end]
        if whole or _crc_holds(frame[:end]):
            statuses.append(Status(block[1], block[0], block[2:-2]))
    return statuses


def _crc_holds(frame: bytes) -> bool:
    return crc16(frame[:-2]) == int.from_bytes(frame[-2:], "little")


#: An int: looking a member up in its enumeration costs as much as comparing three.
_STATUS: Final = int(Instruction.STATUS)


class Frame(NamedTuple):
    """One packet with a valid CRC. parameters: without stuffing; raw: the bytes received."""

    packet_id: int
    instruction: int
    parameters: bytes
    raw: bytes


class FrameParser:
    """Parser of a byte stream: feed it what arrives, and it returns every whole packet, in order.

    A damaged packet costs that packet only: the search goes on at the next header inside it. Noise
    is skipped. Bounded: it never keeps more than one packet of the longest length. pending: bytes
    that may still become a packet; n_bad: damaged packets so far.
    """

    def __init__(self) -> None:
        self.pending = b""
        self.n_bad = 0

    def reset(self) -> None:
        """Forget the bytes that have not become a packet."""
        self.pending = b""

    def feed(self, data: bytes) -> list[Frame]:
        """Append received bytes; return the packets that they complete, in order.

        Bytes of an unfinished packet stay in `pending` for the next call.
        """
        buffer = self.pending + data if self.pending else data
        frames: list[Frame] = []
        at = 0
        while True:
            start = buffer.find(HEADER, at)
            if start < 0:  # only the last bytes are kept, if they may begin a header
                kept = next((n for n in (3, 2, 1) if buffer.endswith(HEADER[:n], at)), 0)
                at = len(buffer) - kept
                break
            at = start
            if len(buffer) - start < 7:  # the length field has yet to come
                break
            length = buffer[start + 5] | buffer[start + 6] << 8
            end = start + 7 + length
            if not 3 <= length <= MAX_LENGTH:
                self.n_bad += 1
                at = start + len(HEADER)
            elif end > len(buffer):  # not whole yet, or damaged if it contains a whole packet
                inner = self._whole_packet_inside(buffer, start)
                if inner is None:
                    break
                self.n_bad += 1
                at = inner
            elif crc16(buffer[start : end - 2]) == buffer[end - 2] | buffer[end - 1] << 8:
                frames.append(_frame(buffer[start:end]))
                at = end
            else:
                self.n_bad += 1
                at = start + len(HEADER)
        self.pending = buffer[at:]
        return frames

    @staticmethod
    def _whole_packet_inside(buffer: bytes, start: int) -> int | None:
        """Return where a whole packet begins inside the unfinished one at `start`; None: nowhere.

        An unfinished packet that contains a whole one is damaged, since stuffing keeps headers out
        of packets. The reply to a fast read is not stuffed; a header in its data is very unlikely
        to be followed by bytes with the right CRC.
        """
        at = buffer.find(HEADER, start + len(HEADER))
        while 0 <= at <= len(buffer) - EMPTY_PACKET_SIZE:
            end = at + 7 + (buffer[at + 5] | buffer[at + 6] << 8)
            if (
                end - at >= EMPTY_PACKET_SIZE
                and end <= len(buffer)
                and crc16(buffer[at : end - 2]) == buffer[end - 2] | buffer[end - 1] << 8
            ):
                return at
            at = buffer.find(HEADER, at + len(HEADER))
        return None


def _frame(raw: bytes) -> Frame:
    packet_id, instruction, parameters = raw[4], raw[7], raw[8:-2]
    # Parameters of the fast replies, which have the broadcast id, are positional and not stuffed.
    if packet_id != BROADCAST_ID or instruction != _STATUS:
        parameters = unstuff(parameters)
    return Frame(packet_id, instruction, parameters, raw)


#: Where the first servo's block begins in a common frame.
_BLOCKS_AT: Final = 8


class GoalWrite:
    """A prepared sync write of one four-byte register of several servos; only values are new."""

    def __init__(self, ids: Sequence[int], address: int) -> None:
        """Prepare the packet to servos `ids` for the four-byte register at `address`."""
        self._blocks = np.zeros(len(ids), dtype=[("id", "u1"), ("value", "<i4")])
        self._blocks["id"] = ids
        self._values = self._blocks["value"]
        parameters = struct.pack("<HH", address, 4)
        length = len(parameters) + 5 * len(ids) + 3
        head = struct.pack("<BHB", BROADCAST_ID, length, Instruction.SYNC_WRITE)
        self._head = HEADER + head + parameters

    def request(self, values: ArrayLike) -> bytes:
        """Return the Sync Write packet that sets the register to these whole numbers, one a servo.

        Parameters
        ----------
        values : ArrayLike
            (n_servos,), in the order of the ids.

        Returns
        -------
        bytes
            The packet with its CRC, bytes.
        """
        self._values[:] = values
        blocks = self._blocks.tobytes()
        if b"\xff\xff\xfd" in blocks:  # to be stuffed, so the prepared header does not fit
            parameters = self._head[8:] + blocks
            return packet(BROADCAST_ID, Instruction.SYNC_WRITE, parameters)
        raw = self._head + blocks
        return raw + crc16(raw).to_bytes(2, "little")


class CommonFrame(Sequence[Status]):
    """The undisturbed answer to a fast sync read: the statuses of all servos, in one frame.

    Statuses are made when they are read one by one; `blocks` has all of them at once. errors: one
    byte for each servo, in order.
    """

    def __init__(self, ids: tuple[int, ...], size: int, stream: bytes) -> None:
        """Wrap the frame `stream`, whose ids and CRC the caller has checked.

        size: data bytes of each servo.
        """
        self.ids = ids
        self.stream = stream
        self.errors = stream[_BLOCKS_AT :: size + 4]
        self._size = size

    @staticmethod
    def size_of(n_servos: int, size: int) -> int:
        """Return the bytes of a common frame of `n_servos` servos with `size` data bytes each."""
        return _BLOCKS_AT + n_servos * (size + 4)

    @staticmethod
    def block_of(data: np.dtype[np.void]) -> np.dtype[np.void]:
        """Return the data type of one servo's block in the frame, for data bytes of type `data`."""
        return np.dtype([("error", "u1"), ("id", "u1"), *data.descr, ("crc", "<u2")])

    @staticmethod
    def blocks(stream: bytes | bytearray, block: np.dtype[np.void]) -> NDArray[np.void]:
        """Return a view of all servos' fields in `stream`, the frame that answers a fast sync read.

        The buffer may be filled later: the view then shows the new values.

        Parameters
        ----------
        stream : bytes | bytearray
            The frame, at its full length.
        block : np.dtype[np.void]
            Data type of one servo's block, from `block_of`.

        Returns
        -------
        NDArray[np.void]
            (n_servos,), in the order of the request.
        """
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
    """A prepared request to several servos for `size` bytes each from `address` on.

    fast: they answer in one common frame instead of one frame each.
    """

    def __init__(self, ids: Sequence[int], address: int, size: int, *, fast: bool) -> None:
        """Prepare the request, and the bytes by which the expected answer is recognised.

        reply_size: bytes of the whole answer. `_step`, `_heads`: of each servo's own frame, if not
        fast, its size and first eight bytes.
        """
        self.ids = tuple(ids)
        self.address = address
        self.size = size
        self.fast = fast
        self.request = sync_read(self.ids, address, size, fast=fast)
        self._step = size + EMPTY_STATUS_SIZE
        self._heads = [
            HEADER + struct.pack("<BHB", each, size + 4, Instruction.STATUS) for each in self.ids
        ]
        n = len(self.ids)
        length = 1 + n * (size + 4)
        self._fast_head = HEADER + struct.pack("<BHB", BROADCAST_ID, length, _STATUS)
        self._id_bytes = bytes(self.ids)
        # A common frame: eight bytes, then error, id, data and CRC of each servo.
        self.reply_size = EMPTY_PACKET_SIZE - 2 + n * (size + 4) if fast else n * self._step
        #: Bytes in the status packet that answers: of one servo, or the common frame of all.
        self.answer_size = self.reply_size - EMPTY_STATUS_SIZE if fast else size
        self._wider: dict[int, SpanRead] = {}

    def widened(self, size: int) -> "SpanRead":
        """Return a read of `size` bytes that includes this read, beginning earlier where possible.

        Its answers have another size, and so are not mistaken for late ones to this read. Earlier,
        since every control table begins at 0, while their ends differ. Made once for each size.
        """
        if size == self.size:
            return self
        if size not in self._wider:
            more = size - self.size
            address = self.address - more if self.address >= more else self.address
            self._wider[size] = SpanRead(self.ids, address, size, fast=self.fast)
        return self._wider[size]

    def cut(self, statuses: Sequence[Status], address: int) -> list[Status]:
        """Return the statuses of a wider read, reduced to the bytes of this read.

        address: the register address at which the data in `statuses` begin.
        """
        own = slice(self.address - address, self.address - address + self.size)
        return [Status(each.servo_id, each.error, each.data[own]) for each in statuses]

    def is_over(self, stream: bytes) -> bool:
        """Return whether the answer is complete: all bytes arrived, or the last servo has answered.

        On a half-duplex line no servo answers after the last one, even if earlier ones were silent.
        """
        if self.fast:
            return len(stream) >= self.reply_size and stream.startswith(self._fast_head)
        # Whether the last `_step` bytes begin as the frame of the last servo does.
        return stream[-self._step : 8 - self._step] == self._heads[-1]

    def take_undisturbed(self, stream: bytes) -> Sequence[Status] | None:
        """Return all statuses when `stream` is exactly the expected answer; None for all else.

        None, too, for an answer with stuffed data, which `Line` parses.
        """
        if len(stream) != self.reply_size:
            return None
        if self.fast:
            # An error byte and the id begin every servo's block, behind a head of eight bytes.
            if stream[:8] != self._fast_head or stream[9 :: self.size + 4] != self._id_bytes:
                return None
            if crc16(stream[:-2]) != stream[-2] | stream[-1] << 8:
                return None
            return CommonFrame(self.ids, self.size, stream)
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
        """Return the statuses that arrived whole in a disturbed or cut common frame; [] if none.

        Bytes before the frame are skipped; a status of another id than expected is left out.
        """
        start = stream.find(self._fast_head)
        if start < 0:
            return []
        found = split_fast_status(stream[start : start + self.reply_size], self.size)
        return [
            status
            for status, expected in zip(found, self.ids, strict=False)
            if status.servo_id == expected
        ]
