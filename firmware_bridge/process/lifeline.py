"""Messages from a child process to its supervisor: heartbeats, and what must outlive the process.

The lifeline is a socket pair, one end each. Nothing here waits: while the supervisor does not read,
heartbeats are lost, but no other message.
"""

import json
import os
import socket
import time
from collections import deque
from collections.abc import Callable
from dataclasses import astuple, dataclass
from typing import Final, get_args

from firmware_bridge.stopping import StopLevel

#: Often enough to be missed within a second, rarely enough to cost nothing.
_BEAT_S: Final = 0.05
#: As many servos as a chain can have, and a stop or two.
_MOST_UNSENT: Final = 256
_LONGEST_REASON: Final = 400
#: In bytes; a character takes twelve at most.
_LONGEST: Final = 8192
#: More than a second of everything a process says; bounds the time of one reading.
_MOST_AT_ONCE: Final = 400


@dataclass(frozen=True, slots=True)
class Stopped:
    """The message to the supervisor that a person stopped the face.

    ends: whether the process ends with the stop. requested_by: process and user, for a log.
    """

    level: StopLevel
    ends: bool = False
    requested_by: str = ""


@dataclass(frozen=True, slots=True)
class Started:
    """The message that a person ended a freeze: the face is driven again."""


@dataclass(frozen=True, slots=True)
class NotStarted:
    """The message that torque could not be switched on at a start, and why."""

    reason: str


@dataclass(frozen=True, slots=True)
class Failed:
    """The message that the servo number `index` of the face was given up for good, and why."""

    index: int
    reason: str


@dataclass(frozen=True, slots=True)
class Switched:
    """The message that a person switched servo number `index` off, or on after any failure."""

    index: int
    on: bool


@dataclass(frozen=True, slots=True)
class Began:
    """The message that time 0 of the spoken sound was at the monotonic time `zero_s`."""

    zero_s: float


@dataclass(frozen=True, slots=True)
class Ready:
    """The message that the servos are driven now."""


Message = Stopped | Started | NotStarted | Failed | Switched | Began | Ready
_KINDS: Final = {kind.__name__: kind for kind in get_args(Message)}

_BEAT: Final = "Beat"


class Lifeline:
    """The child's end of its connection to the supervisor; no method waits or raises.

    While the connection has no room, messages other than heartbeats are kept for the next
    heartbeat. closed: whether the supervisor is gone.
    """

    def __init__(
        self, end: socket.socket | int, now_s: Callable[[], float] = time.monotonic
    ) -> None:
        """Use `end`, a socket or the descriptor number of an inherited socket."""
        self._end = socket.socket(fileno=end) if isinstance(end, int) else end
        self._end.setblocking(False)
        self._now_s = now_s
        self._beat_s = float("-inf")
        self._unsent: deque[bytes] = deque(maxlen=_MOST_UNSENT)
        self.closed = False

    def beat(self) -> None:
        """Send a heartbeat, every .05 s at most, and unsent messages; call it in every round."""
        now_s = self._now_s()
        if now_s - self._beat_s < _BEAT_S:
            return
        self._beat_s = now_s
        if self._unsent:
            self._flush()
        self._send(json.dumps([_BEAT, now_s]).encode())

    def tell(self, message: Message) -> None:
        """Send a message; it is not lost while the supervisor lives. Long texts are cut off."""
        values = [
            each[:_LONGEST_REASON] if isinstance(each, str) else each for each in astuple(message)
        ]
        self._unsent.append(json.dumps([type(message).__name__, *values]).encode())
        self._flush()

    def is_cut(self) -> bool:
        """Return whether the supervisor has closed its end, or died; sends nothing."""
        try:
            return not self._end.recv(1, socket.MSG_PEEK)
        except BlockingIOError:
            return False
        except OSError:
            return True

    def close(self) -> None:
        """Close the child's end of the connection."""
        self._end.close()

    def _flush(self) -> None:
        while self._unsent and self._send(self._unsent[0]):
            self._unsent.popleft()

    def _send(self, message: bytes) -> bool:
        """Send a message without waiting; return False only if the connection has no room."""
        try:
            self._end.send(message, socket.MSG_NOSIGNAL)
        except BlockingIOError:
            return False
        except OSError:
            self.closed = True  # the supervisor is gone: there is nobody to send to
        return True


class LifelineWatch:
    """The supervisor's end of its connection to a child.

    beat_s: monotonic time of the newest heartbeat; None: none yet. closed: whether the child has
    closed its end.
    """

    def __init__(self, end: socket.socket) -> None:
        self._end = end
        self._end.setblocking(False)
        self.beat_s: float | None = None
        self.closed = False

    def fileno(self) -> int:
        """Return the descriptor: readable when a message has come or the child closed its end."""
        return self._end.fileno()

    def read(self) -> list[Message]:
        """Return the messages since the last call, in order, without heartbeats; never waits."""
        messages: list[Message] = []
        for _ in range(_MOST_AT_ONCE):
            try:
                raw = self._end.recv(_LONGEST)
            except BlockingIOError:
                break
            except OSError:
                raw = b""
            if not raw:
                self.closed = True
                break
            message = _understood(raw)
            if isinstance(message, float):
                self.beat_s = max(message, self.beat_s or 0.0)
            elif message is not None:
                messages.append(message)
        return messages

    def close(self) -> None:
        """Close the supervisor's end of the connection."""
        self._end.close()


def lifeline_pair() -> tuple[socket.socket, LifelineWatch]:
    """Return the two ends of a new connection: one for the child to inherit, the supervisor's."""
    child, supervisor = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    return child, LifelineWatch(supervisor)


def inherited_lifeline(fd: int) -> Lifeline:
    """Return the child's end of its lifeline, whose descriptor `fd` the child inherited."""
    os.set_inheritable(fd, False)
    return Lifeline(fd)


def _understood(raw: bytes) -> Message | float | None:
    """Return the message of some bytes, or the time of a heartbeat; None: they are neither."""
    try:
        kind, *values = json.loads(raw)
        if kind == _BEAT:
            return float(values[0])
        if kind == Stopped.__name__:
            values[0] = StopLevel(values[0])
        message: Message = _KINDS[kind](*values)
    except (ValueError, TypeError, LookupError):
        return None
    return message
