"""Packets of Feetech's protocol as bytes: made, found in a stream, or prepared for every tick.

    FF FF | id | length | instruction, or status of an answer | parameters | checksum

length counts everything after itself; the checksum is the inverted sum of all bytes from the id on.
There is no stuffing: FF FF may appear within a packet. Numbers are little- or big-endian by
dialect. http://doc.feetech.cn/ , FT-SCS-Protocol.
"""

from collections.abc import Iterable, Iterator, Sequence
from enum import IntEnum
from functools import lru_cache
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from firmware_bridge.feetech.control_table import TORQUE_ENABLE

HEADER: Final = b"\xff\xff"
#: Bytes of a packet without parameters.
EMPTY_SIZE: Final = 6
BROADCAST_ID: Final = 254
MAX_ID: Final = 253


class Instruction(IntEnum):
    """The instructions sent here. A ping is not among them: its echo looks like its answer."""

    READ = 0x02
    WRITE = 0x03
    SYNC_READ = 0x82
    SYNC_WRITE = 0x83


class Status(NamedTuple):
    """The answer of one servo. error: bits of register `status`; data: the bytes that were read."""

    servo_id: int
    error: int
    data: bytes


def packet(packet_id: int, instruction: int, parameters: bytes = b"") -> bytes:
    """Return a whole packet to or from servo `packet_id`, with its checksum.

    A servo's answer has its status in place of `instruction`. Raises ValueError when the parameters
    do not fit: the length field counts to 255.
    """
    body = bytes((packet_id, len(parameters) + 2, instruction)) + parameters
    return HEADER + body + bytes((~sum(body) & 0xFF,))


@lru_cache(maxsize=1024)
def read(servo_id: int, address: int, size: int) -> bytes:
    """Return the request for `size` bytes of one servo from `address` on.

    Cached, since a tick sends it often.
    """
    return packet(servo_id, Instruction.READ, bytes((address, size)))


def write(servo_id: int, address: int, data: bytes) -> bytes:
    """Return the packet that sets bytes of one servo from `address` on.

    Raises ValueError where the bytes reach register `torque_enable`.
    """
    return packet(servo_id, Instruction.WRITE, _beside_torque(address, data) + data)


def sync_write(address: int, size: int, blocks: Iterable[tuple[int, bytes]]) -> bytes:
    """Return the packet that sets `size` bytes of several servos from `address` on.

    blocks: (id, bytes) of each servo. No servo answers the packet.
    """
    listed = b"".join(bytes((servo_id,)) + each for servo_id, each in blocks)
    parameters = _beside_torque(address, bytes(size)) + bytes((size,)) + listed
    return packet(BROADCAST_ID, Instruction.SYNC_WRITE, parameters)


def torque(ids: Sequence[int], *, on: bool) -> bytes:
    """Return the packet that switches torque of `ids` on or off; without ids, of all servos off.

    The only packet that writes register `torque_enable`, in which 128 would make the present
    position the middle of the range, for good.
    """
    if not ids:
        return packet(BROADCAST_ID, Instruction.WRITE, bytes((TORQUE_ENABLE, 0)))
    blocks = b"".join(bytes((servo_id, 1 if on else 0)) for servo_id in ids)
    return packet(BROADCAST_ID, Instruction.SYNC_WRITE, bytes((TORQUE_ENABLE, 1)) + blocks)


def _beside_torque(address: int, data: bytes) -> bytes:
    if address <= TORQUE_ENABLE < address + len(data):
        raise ValueError("torque is not written as a register; call `torque`")
    return bytes((address,))


def packets_in(stream: bytes) -> Iterator[tuple[Status | None, int]]:
    """Yield (packet, index of its end) for every whole packet in a stream of received bytes.

    (None, index of its first byte) for a damaged or unfinished packet; the search goes on inside
    that packet. All other bytes are skipped. An instruction has its code in place of `error`.
    """
    # A packet is whole if the sum from the id to the checksum ends in 255.
    at = 0
    while (at := stream.find(HEADER, at)) >= 0 and at + EMPTY_SIZE <= len(stream):
        end = at + 4 + stream[at + 3]
        is_packet = stream[at + 2] <= BROADCAST_ID and stream[at + 3] >= 2
        if is_packet and end <= len(stream) and sum(stream[at + 2 : end]) & 0xFF == 0xFF:
            yield Status(stream[at + 2], stream[at + 4], stream[at + 5 : end - 1]), end
            at = end
        else:
            if is_packet:
                yield None, at
            at += 1


def statuses_in(stream: bytes) -> list[Status]:
    """Return every whole packet in a stream, skipping all other bytes."""
    return [status for status, _ in packets_in(stream) if status is not None]


#: Bytes of goal, time and speed of one servo; how many servos fit into a packet of 255 bytes.
_GOAL_BYTES: Final = 6
_MOST_GOALS: Final = (255 - 4) // (1 + _GOAL_BYTES)


class GoalWrite:
    """A prepared sync write of goal_position, goal_time and goal_speed; only values are new.

    Each goal brings its speed, since a servo that has restarted knows none; the time is 0: go by
    the speed.
    """

    def __init__(
        self, ids: Sequence[int], address: int, byte_order: Literal["little", "big"]
    ) -> None:
        """Prepare for the servos `ids`; address: of register goal_position."""
        number = "<u2" if byte_order == "little" else ">u2"
        fields = [("id", "u1"), ("goal", number), ("time", number), ("speed", number)]
        self._blocks = np.zeros(len(ids), dtype=fields)
        self._blocks["id"] = ids
        self._goals, self._speeds = self._blocks["goal"], self._blocks["speed"]
        # For each packet: its bytes before the blocks, their sum for the checksum, and its blocks.
        self._parts = []
        for first in range(0, len(ids), _MOST_GOALS):
            part = self._blocks[first : first + _MOST_GOALS]
            begins = bytes((BROADCAST_ID, 4 + part.nbytes, Instruction.SYNC_WRITE, address))
            begins += bytes((_GOAL_BYTES,))
            self._parts.append((HEADER + begins, sum(begins), part))

    def request(self, goals: ArrayLike, speeds: ArrayLike) -> bytes:
        """Return the Sync Write that sets goals and speeds, both whole numbers, 0 or above.

        Parameters
        ----------
        goals, speeds : ArrayLike
            (n_servos,) each, in the order of the ids; fractions are cut off.

        Returns
        -------
        bytes
            The packet with its checksum; several in a row for more than 35 servos.
        """
        self._goals[:] = goals
        self._speeds[:] = speeds
        packets = b""
        for head, head_sum, part in self._parts:
            blocks = part.tobytes()
            packets += head + blocks + bytes((~(head_sum + sum(blocks)) & 0xFF,))
        return packets


class SpanRead:
    """A prepared request to several servos for `size` bytes each from `address` on."""

    def __init__(self, ids: Sequence[int], address: int, size: int) -> None:
        """Prepare the request, and the bytes by which undisturbed answers are recognised.

        step: bytes of one servo's answer; reply_size: of all answers.
        """
        self.ids = tuple(ids)
        self.address, self.size = address, size
        parameters = bytes((address, size, *ids))
        self.request = packet(BROADCAST_ID, Instruction.SYNC_READ, parameters)
        self.step = size + EMPTY_SIZE
        n = len(self.ids)
        self.reply_size = n * self.step
        self._id_bytes, self._length_bytes = bytes(ids), bytes((size + 2,)) * n
        self._header_bytes = b"\xff" * n
        # An answer's bytes add up to 253: 255 from id to checksum, and two header bytes of 255.
        self._sum_bytes = b"\xfd" * n

    def is_undisturbed(self, stream: bytes) -> bool:
        """Return whether `stream` is exactly the answers of all servos, in the order of the ids."""
        step = self.step
        if (
            len(stream) != self.reply_size
            or stream[2::step] != self._id_bytes
            or stream[3::step] != self._length_bytes
            or stream[::step] != self._header_bytes
            or stream[1::step] != self._header_bytes
        ):
            return False
        # The bytes of each answer must add up to 253, modulo 256: see `__init__`.
        sums = np.frombuffer(stream, np.uint8).reshape(-1, step).sum(axis=1, dtype=np.uint8)
        return bool(sums.tobytes() == self._sum_bytes)
