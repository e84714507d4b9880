"""Protocol 2.0 packets as bytes: pure functions, no ports, no time.

https://emanual.robotis.com/docs/en/dxl/protocol2/

    FF FF FD 00 | id | length, 2 bytes | instruction | parameters | CRC-16, 2 bytes

length counts everything after itself. Inside instruction and parameters `FF FF FD` is sent as
`FF FF FD FD` (stuffing), so that a header never appears within a packet. The CRC covers the stuffed
bytes. All numbers are little-endian.
"""

import struct
from collections.abc import Iterable, Sequence
from enum import IntEnum
from functools import lru_cache
from typing import Final, NamedTuple

from fastcrc import crc16 as _crc16

#: On the wire: start bit, eight data bits, stop bit.
BITS_PER_BYTE: Final = 10
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
#: No packet is longer than this: a fast sync read of 252 servos and 40 bytes each. A length field
#: above it is noise, and not waited for.
MAX_LENGTH: Final = 12_000
#: Added to the error number while a servo's hardware_error_status is not 0.
ALERT_BIT: Final = 0x80


class Instruction(IntEnum):
    """https://emanual.robotis.com/docs/en/dxl/protocol2/#instruction ."""

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
    """https://emanual.robotis.com/docs/en/dxl/protocol2/#error ."""

    NONE = 0
    RESULT_FAIL = 1
    INSTRUCTION = 2
    CRC = 3
    DATA_RANGE = 4
    DATA_LENGTH = 5
    DATA_LIMIT = 6
    ACCESS = 7


class Status(NamedTuple):
    """What one servo answered. error: a `StatusError`, plus `ALERT_BIT`."""

    servo_id: int
    error: int
    data: bytes


def stuff(body: bytes) -> bytes:
    """Hide every header pattern in the parameters; no instruction is FF, so none begins before."""
    return body.replace(_PATTERN, _STUFFED)


def unstuff(body: bytes) -> bytes:
    """Undo `stuff`."""
    return body.replace(_STUFFED, _PATTERN)


def packet(packet_id: int, instruction: int, parameters: bytes = b"") -> bytes:
    """A whole packet, ready for the wire.

    Raises ValueError when it does not fit: the length field counts to 65,535.
    """
    body = stuff(parameters)
    length = len(body) + 3
    if length > 0xFFFF:
        raise ValueError(f"{len(parameters)} bytes do not fit into a packet")
    head = HEADER + struct.pack("<BHB", packet_id, length, instruction) + body
    return head + crc16(head).to_bytes(2, "little")


def ping(servo_id: int) -> bytes:
    """Ask for model number and firmware version; `BROADCAST_ID` asks everybody."""
    return packet(servo_id, Instruction.PING)


@lru_cache(maxsize=1024)
def read(servo_id: int, address: int, size: int) -> bytes:
    """Ask one servo for `size` bytes. Remembered: a tick asks two questions of each, in turn."""
    return packet(servo_id, Instruction.READ, struct.pack("<HH", address, size))


def write(servo_id: int, address: int, data: bytes) -> bytes:
    """Set bytes of one servo, or of all by `BROADCAST_ID`."""
    return packet(servo_id, Instruction.WRITE, struct.pack("<H", address) + data)


def reboot(servo_id: int) -> bytes:
    """Restart a servo; this also clears its hardware error."""
    return packet(servo_id, Instruction.REBOOT)


def sync_read(ids: Sequence[int], address: int, size: int, *, fast: bool = False) -> bytes:
    """Ask several servos for the same bytes; they answer one after another in this order.

    fast: in one common frame instead of one frame each.
    """
    instruction = Instruction.FAST_SYNC_READ if fast else Instruction.SYNC_READ
    return packet(BROADCAST_ID, instruction, struct.pack("<HH", address, size) + bytes(ids))


def sync_write(address: int, size: int, data: Iterable[tuple[int, bytes]]) -> bytes:
    """Set the same `size` bytes of several servos, (id, bytes) each; nobody answers."""
    blocks = b"".join(bytes((servo_id,)) + each for servo_id, each in data)
    parameters = struct.pack("<HH", address, size) + blocks
    return packet(BROADCAST_ID, Instruction.SYNC_WRITE, parameters)


def status(servo_id: int, error: int = 0, data: bytes = b"") -> bytes:
    """What a servo answers. The simulator's half of the codec."""
    return packet(servo_id, Instruction.STATUS, bytes((error,)) + data)


def undisturbed_status(raw: bytes) -> Status | None:
    """The status that `raw` is, bytes from header to CRC; None for all else, and where stuffed."""
    size = len(raw) - 7
    if raw[:4] != HEADER or raw[5:8] != _STATUS_HEAD.pack(size, Instruction.STATUS):
        return None
    if crc16(raw[:-2]) != raw[-2] | raw[-1] << 8 or _STUFFED in raw:
        return None
    return Status(raw[4], raw[8], raw[9:-2])


def fast_status(blocks: Sequence[tuple[int, int, bytes]]) -> bytes:
    """The common frame that (id, error, data) together answer a fast sync read with.

    Positional, so it is not stuffed; each block ends in the CRC of everything up to there.
    """
    length = 1 + sum(4 + len(data) for _, _, data in blocks)
    frame = bytearray(HEADER + struct.pack("<BHB", BROADCAST_ID, length, Instruction.STATUS))
    for servo_id, error, data in blocks:
        frame += bytes((error, servo_id)) + data
        frame += crc16(bytes(frame)).to_bytes(2, "little")
    return bytes(frame)


def split_fast_status(frame: bytes, size: int) -> list[Status]:
    """Take apart the common frame of a fast sync read of `size` bytes each.

    `frame` may be cut off: blocks that arrived whole and whose own CRC holds are salvaged. When the
    frame's last CRC holds, all its blocks count, whatever the inner CRCs say: whether real servos
    send them cumulative, as here, is not verified on hardware.
    """
    step = size + 4
    ends = range(8 + step, len(frame) + 1, step)
    declared = int.from_bytes(frame[5:7], "little") + 7
    whole = len(frame) >= declared and _crc_holds(frame[:declared])
    statuses = []
    for end in ends:
        if end > declared:
            break
        block = frame[end - step : end]
        if whole or _crc_holds(frame[:end]):
            statuses.append(Status(block[1], block[0], block[2:-2]))
    return statuses


def _crc_holds(frame: bytes) -> bool:
    return crc16(frame[:-2]) == int.from_bytes(frame[-2:], "little")
