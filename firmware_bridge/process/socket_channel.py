"""Targets from one process to another: one record a packet, nobody ever blocks."""

import select
import socket
import struct
from typing import Final

import numpy as np

from firmware_bridge.targets import ServoTargets

_HEAD: Final = struct.Struct("<Qd")
_ANGLE: Final = np.dtype("<f8")
#: Room for a second of targets at 1000 a second; a reader at 30 Hz never lets it fill.
_BUFFER_BYTES: Final = 1 << 20
#: More than a reader needs in one go; bounds the time of a tick when somebody floods the channel.
_MOST_AT_ONCE: Final = 1_000
_LONGEST_RECORD: Final = 16_384


def channel_pair() -> tuple[socket.socket, socket.socket]:
    """(writer, reader), both inheritable by name only.

    SOCK_SEQPACKET rather than SOCK_DGRAM: the kernel lets only ten datagrams wait
    (net.unix.max_dgram_qlen), and a reader could not tell that the writer has died.
    """
    writer, reader = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    writer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER_BYTES)
    return writer, reader


class SocketTargetChannel:
    """One end of a `channel_pair` as `TargetChannel`: publish at one end, drain at the other."""

    def __init__(self, end: socket.socket) -> None:
        self._end = end
        self._end.setblocking(False)
        self._ready = select.poll()
        self._ready.register(end, select.POLLIN)
        self._sequence = 0
        self.n_dropped = 0
        self.closed = False

    def publish(self, targets: ServoTargets) -> None:
        """Hand over one record; dropped and counted when the reader is far behind or gone."""
        self._sequence += 1
        values = np.ascontiguousarray(targets.positions_deg, dtype="<f8").tobytes()
        try:
            self._end.send(_HEAD.pack(self._sequence, targets.time_s) + values)
        except OSError:
            self.n_dropped += 1

    def drain(self) -> list[ServoTargets]:
        """All that has come, oldest first, the newest thousand at most; counts the gaps."""
        records: list[ServoTargets] = []
        for _ in range(_MOST_AT_ONCE):
            if not self._ready.poll(0):  # half as dear as an error that says there is nothing
                break
            try:
                raw = self._end.recv(_LONGEST_RECORD)
            except OSError:
                self.closed = True
                break
            if not raw:
                self.closed = True
                break
            if len(raw) < _HEAD.size or (len(raw) - _HEAD.size) % 8:
                self.n_dropped += 1
                continue
            sequence, time_s = _HEAD.unpack_from(raw)
            if sequence > self._sequence + 1:
                self.n_dropped += sequence - self._sequence - 1
            self._sequence = sequence
            records.append(ServoTargets(time_s, np.frombuffer(raw, _ANGLE, offset=_HEAD.size)))
        return records
