"""Targets on their way to the bridge: the channels, and the motion that is read from them."""

import math
import select
import socket
import struct
from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, Protocol

import numpy as np

from firmware_bridge.bus import Array, all_set
from firmware_bridge.gate.ramp import StaleLevel, StaleRule


@dataclass(frozen=True, slots=True)
class ServoTargets:
    """Target joint angles for the monotonic display time `time_s`.

    positions_deg: (n_servos,), in the order of the face's servo names, 0 = the joint's neutral.
    """

    time_s: float
    positions_deg: Array


class TargetChannel(Protocol):
    """A one-way channel for target joint angles; it never blocks, and drops what does not fit."""

    def publish(self, targets: ServoTargets) -> None:
        """Send one target record to the reader."""

    def drain(self) -> list[ServoTargets]:
        """Return the records published since the last call and not dropped, oldest first."""


#: Longest step beyond the newest target along its slope. At the mouth's usual 5 Hz and below it is
#: a quarter of a cycle: the slope still tells the direction, later it does not.
MAX_EXTRAPOLATION_S = 0.050
#: Targets closer in time than this are for the same moment, and the later one published counts: a
#: tenth of the 100 Hz spacing of speech. So a slope is never a quotient of two rounding errors.
SAME_MOMENT_S = 0.001


class MemoryTargetChannel:
    """A `TargetChannel` inside one process and one thread: replay, tests, a face on this computer.

    Contains at most `capacity` records; publishing into a full channel drops the oldest. n_dropped:
    records that were overwritten before they were drained.
    """

    def __init__(self, capacity: int = 32) -> None:
        self._records: deque[ServoTargets] = deque(maxlen=capacity)
        self.n_dropped = 0

    def publish(self, targets: ServoTargets) -> None:
        """Append one target record; drop the oldest if the channel is full."""
        if len(self._records) == self._records.maxlen:
            self.n_dropped += 1
        self._records.append(targets)

    def drain(self) -> list[ServoTargets]:
        """Return the records published since the last call and not dropped, oldest first."""
        records = list(self._records)
        self._records.clear()
        return records


class TargetTrack:
    """The newest targets in order of display time, interpolated to one continuous motion.

    A record is valid from its time on: it replaces every kept one at or after that time, so a
    speech process that revises, or starts again, is never mixed with its earlier records. Records
    with the wrong number of joints, or anything not finite, are left out; n_rejected: how many.
    """

    def __init__(self, n_servos: int, n_kept: int = 256) -> None:
        """Set the number of records kept: 256 are 2.5 s at 100 Hz, more than come ahead."""
        self._shape = (n_servos,)
        self._n_kept = n_kept
        self._times_s: list[float] = []
        self._positions_deg: list[Array] = []
        self.n_rejected = 0

    def push(self, records: Iterable[ServoTargets]) -> None:
        """Insert records in the order they were published; leave out invalid ones."""
        for record in records:
            positions_deg, time_s = record.positions_deg, record.time_s
            is_valid = (
                positions_deg.shape == self._shape
                and math.isfinite(time_s)
                and all_set(np.isfinite(positions_deg))
            )
            if not is_valid:
                self.n_rejected += 1
                continue
            times_s = self._times_s
            # A target later than all before is appended, nearly always; else it replaces those from
            # its time on, which belong to a plan that speech has revised.
            if not times_s or times_s[-1] < time_s - SAME_MOMENT_S:
                times_s.append(time_s)
                self._positions_deg.append(positions_deg)
            else:
                replaced = bisect_left(times_s, time_s - SAME_MOMENT_S)
                times_s[replaced:] = [time_s]
                self._positions_deg[replaced:] = [positions_deg]
            if len(times_s) > self._n_kept:
                del times_s[0], self._positions_deg[0]

    def at(self, time_s: float) -> tuple[Array | None, float]:
        """Return the positions for a time, and the age of the newest target due by then.

        Linear between targets; beyond the newest along its last slope for `MAX_EXTRAPOLATION_S`,
        then held. Targets not yet due count for nothing in the age: a sender that dates them into
        the far future has gone quiet.

        Parameters
        ----------
        time_s : float
            Monotonic seconds.

        Returns
        -------
        tuple[Array | None, float]
            (n_servos,) degrees and seconds; before the first target is due (None, infinity).
        """
        n_due = bisect_right(self._times_s, time_s)
        if n_due == 0:
            return None, float("inf")
        age_s = time_s - self._times_s[n_due - 1]
        if n_due < len(self._times_s):
            return self._on_line(n_due - 1, time_s), age_s
        if n_due == 1:
            return self._positions_deg[0], age_s
        # Beyond the newest target: on the line through the last two, for 50 ms at most.
        return self._on_line(n_due - 2, time_s - max(0.0, age_s - MAX_EXTRAPOLATION_S)), age_s

    def _on_line(self, left: int, time_s: float) -> Array:
        """Return the positions at `time_s` on the line through targets `left` and `left + 1`."""
        start_s, end_s = self._times_s[left], self._times_s[left + 1]
        start_deg, end_deg = self._positions_deg[left], self._positions_deg[left + 1]
        return start_deg + (end_deg - start_deg) * ((time_s - start_s) / (end_s - start_s))


_HEAD: Final = struct.Struct("<Qd")
_ANGLE: Final = np.dtype("<f8")
#: Room for a second of targets at 1000 a second; a reader at 30 Hz never lets it fill.
_BUFFER_BYTES: Final = 1 << 20
#: More than a reader needs in one go; bounds the time of a tick when somebody floods the channel.
_MOST_AT_ONCE: Final = 1_000
_LONGEST_RECORD: Final = 16_384


def channel_pair() -> tuple[socket.socket, socket.socket]:
    """Return the sockets (writer, reader) of a new channel; child processes do not inherit them.

    SOCK_SEQPACKET rather than SOCK_DGRAM: the kernel lets only ten datagrams wait
    (net.unix.max_dgram_qlen), and a reader could not detect that the writer has died.
    """
    writer, reader = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    writer.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _BUFFER_BYTES)
    return writer, reader


class SocketTargetChannel:
    """One end of a `channel_pair` as `TargetChannel`: publish at one end, drain at the other."""

    def __init__(self, end: socket.socket) -> None:
        """Use `end`, one of the sockets of `channel_pair`, without blocking."""
        self._end = end
        self._end.setblocking(False)
        self._ready = select.poll()
        self._ready.register(end, select.POLLIN)
        self._sequence = 0
        self.n_dropped = 0
        self.closed = False

    def publish(self, targets: ServoTargets) -> None:
        """Send one record; drop and count it if the socket's buffer is full or the reader gone."""
        self._sequence += 1
        values = np.ascontiguousarray(targets.positions_deg, dtype="<f8").tobytes()
        try:
            self._end.send(_HEAD.pack(self._sequence, targets.time_s) + values)
        except OSError:
            self.n_dropped += 1

    def drain(self) -> list[ServoTargets]:
        """Return the received records, oldest first, a thousand at most; count missing ones.

        Sets `closed` when the writer is gone.
        """
        records: list[ServoTargets] = []
        for _ in range(_MOST_AT_ONCE):
            if not self._ready.poll(0):  # costs half as much as an exception for an empty socket
                break
            try:
                raw = self._end.recv(_LONGEST_RECORD)
            except OSError:
                raw = b""
            if not raw:
                self.closed = True
                break
            if len(raw) < _HEAD.size or (len(raw) - _HEAD.size) % 8:
                self.n_dropped += 1
                continue
            # A record: its number, its time, and an angle for each servo.
            sequence, time_s = _HEAD.unpack_from(raw)
            if sequence > self._sequence + 1:
                self.n_dropped += sequence - self._sequence - 1
            self._sequence = sequence
            records.append(ServoTargets(time_s, np.frombuffer(raw, _ANGLE, offset=_HEAD.size)))
        return records


_FRESH = StaleLevel.FRESH


class FollowedTargets:
    """The targets that a face follows: those published in `channel`, until they are too old.

    Arrays are (n_joints,). held_deg: the newest targets followed. was_spoken_to: whether any was
    followed since the start.
    """

    def __init__(self, channel: TargetChannel, n_joints: int, stale: StaleRule) -> None:
        """Read targets of `n_joints` joints from `channel`; `stale`: when they are too old."""
        self._channel = channel
        self._stale = stale
        self._track = TargetTrack(n_joints)
        self._fresh_deg: Array | None = None
        self._fresh_s = 0.0
        self._heard_s = 0.0  # display time of the newest target due, or of the start if later
        self.held_deg: Array = np.zeros(n_joints)
        self.was_spoken_to = False

    @property
    def n_rejected(self) -> int:
        """The number of targets left out because they were invalid."""
        return self._track.n_rejected

    def begin(self, present_deg: Array, time_s: float) -> None:
        """Hold the joints at these positions until a target comes.

        Parameters
        ----------
        present_deg : Array
            (n_joints,) degrees.
        time_s : float
            Monotonic seconds.
        """
        self.held_deg = present_deg
        self._heard_s = time_s
        self.was_spoken_to = False

    def take(self, time_s: float) -> bool:
        """Read the channel; return whether there is a fresh target for monotonic `time_s`.

        It is stored, interpolated; `follow` makes it the pose that the face holds.
        """
        self._track.push(self._channel.drain())
        target_deg, age_s = self._track.at(time_s)
        if target_deg is None or self._stale.level(age_s) is not _FRESH:
            return False
        self._fresh_deg, self._fresh_s = target_deg, time_s - age_s
        return True

    def follow(self) -> None:
        """Make the fresh target that `take` found the pose to hold from now on."""
        assert self._fresh_deg is not None
        self._heard_s = max(self._heard_s, self._fresh_s)
        self.held_deg = self._fresh_deg
        self.was_spoken_to = True

    def silence_s(self, time_s: float) -> float:
        """Return the age in s of the newest target followed; before the first, since `begin`."""
        return max(0.0, time_s - self._heard_s)

    def wanted(self, silence_s: float, level: StaleLevel) -> Array:
        """Return the targets followed last; after a silence they shrink towards neutral.

        Parameters
        ----------
        silence_s : float
            Seconds since the newest target.
        level : StaleLevel
            What to do after a silence of this length.

        Returns
        -------
        Array
            (n_joints,) degrees.
        """
        if level is _FRESH:
            return self.held_deg
        return self.held_deg * self._stale.weight(silence_s)
