"""Finds packets in a stream of bytes, whatever else is in it."""

from typing import Final, NamedTuple

from firmware_bridge.dynamixel.wire.codec import (
    BROADCAST_ID,
    EMPTY_PACKET_SIZE,
    HEADER,
    MAX_LENGTH,
    Instruction,
    crc16,
    unstuff,
)

#: Parameters of the fast replies are positional and not stuffed.
_UNSTUFFED_ID: Final = BROADCAST_ID
_STATUS: Final = int(Instruction.STATUS)


class Frame(NamedTuple):
    """One packet whose CRC holds. parameters: without stuffing; raw: as it came."""

    packet_id: int
    instruction: int
    parameters: bytes
    raw: bytes


class FrameParser:
    """Feed it what arrives; it gives back every whole packet, in order.

    A damaged packet costs that packet only: the search goes on at the next header inside it. Noise
    is skipped and counted. Bounded: it never keeps more than one packet of the longest length.
    """

    def __init__(self) -> None:
        self._buffer = b""
        self.n_bad = 0
        self.n_noise = 0

    @property
    def pending(self) -> bytes:
        """Bytes that may still become a packet."""
        return self._buffer

    def reset(self) -> None:
        """Forget what has not become a packet."""
        self._buffer = b""

    def feed(self, data: bytes) -> list[Frame]:
        """Take bytes, return the packets that they complete."""
        buffer = self._buffer + data if self._buffer else data
        frames: list[Frame] = []
        at = 0
        while True:
            start = buffer.find(HEADER, at)
            if start < 0:
                kept = _header_begun(buffer, at)
                self.n_noise += len(buffer) - kept - at
                at = len(buffer) - kept
                break
            self.n_noise += start - at
            at = start
            if len(buffer) - start < 7:
                break
            length = buffer[start + 5] | buffer[start + 6] << 8
            end = start + 7 + length
            if not 3 <= length <= MAX_LENGTH:
                self.n_bad += 1
                at = start + len(HEADER)
            elif end > len(buffer):
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
        self._buffer = buffer[at:]
        return frames

    @staticmethod
    def _whole_packet_inside(buffer: bytes, start: int) -> int | None:
        """A packet that waits for bytes although a later, whole one lies inside it is damaged.

        Stuffing keeps headers out of packets, except out of fast replies, which a CRC that holds
        over a whole inner packet tells apart.
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
    fast_reply = packet_id == _UNSTUFFED_ID and instruction == _STATUS
    if not fast_reply:
        parameters = unstuff(parameters)
    return Frame(packet_id, instruction, parameters, raw)


def _header_begun(buffer: bytes, at: int) -> int:
    """How many of the last bytes may be the beginning of a header."""
    for n in (3, 2, 1):
        if len(buffer) - at >= n and buffer.endswith(HEADER[:n]):
            return n
    return 0
