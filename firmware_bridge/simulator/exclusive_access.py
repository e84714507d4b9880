"""Exclusive access to a simulated port ends with the client that asked for it.

TIOCEXCL keeps everybody but root from opening a terminal again. On a real adapter it goes when the
last one closes the port. A pseudo-terminal keeps it for as long as its host has it open, so a
client that is killed would lock the port for good. So the host hears of every close (inotify, as
nothing else tells), and when then the port is exclusive although nobody holds it any more (one look
through /proc, on such a close alone), it ends that. Nothing is done while a client speaks.
"""

import contextlib
import ctypes
import fcntl
import os
import struct
import termios
from pathlib import Path
from typing import Final

#: asm-generic/ioctls.h, sys/inotify.h
_TIOCGEXCL: Final = 0x80045440
_IN_CLOSE: Final = 0x08 | 0x10
_EVENTS: Final = 16_384


class ExclusiveAccess:
    """Watches one pseudo-terminal from its host's side."""

    def __init__(self, slave: int, port: str) -> None:
        """slave: the host's own descriptor of `port`. Where inotify is missing, nothing happens."""
        self._slave = slave
        self._port = port
        self._watch = _watch_closes(port)

    @property
    def descriptors(self) -> list[int]:
        """Readable once somebody has closed the port."""
        return [] if self._watch is None else [self._watch]

    def somebody_closed(self) -> None:
        """Open the port to everybody again, unless a client still holds it."""
        if self._watch is not None:
            with contextlib.suppress(BlockingIOError):
                os.read(self._watch, _EVENTS)
        if self._is_exclusive() and not self._is_held():
            fcntl.ioctl(self._slave, termios.TIOCNXCL)

    def close(self) -> None:
        """Stop watching."""
        if self._watch is not None:
            os.close(self._watch)
            self._watch = None

    def _is_exclusive(self) -> bool:
        try:
            answer = fcntl.ioctl(self._slave, _TIOCGEXCL, bytes(4))
        except OSError:
            return False
        return struct.unpack("i", answer) != (0,)

    def _is_held(self) -> bool:
        """Whether any process, this one included, has the port open besides the host itself.

        Processes of other users cannot be looked into. They could not open the port either, except
        for root, whom exclusive access never kept out.
        """
        own = f"/proc/{os.getpid()}/fd/{self._slave}"
        for folder in Path("/proc").glob("[0-9]*/fd"):
            with contextlib.suppress(OSError):
                for name in os.listdir(folder):
                    path = f"{folder}/{name}"
                    with contextlib.suppress(OSError):
                        if os.readlink(path) == self._port and path != own:
                            return True
        return False


def _watch_closes(path: str) -> int | None:
    """A descriptor that tells of every close of `path`; None where the computer cannot."""
    try:
        libc = ctypes.CDLL(None, use_errno=True)
        watch = libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        if watch < 0:
            return None
        if libc.inotify_add_watch(watch, os.fsencode(path), _IN_CLOSE) >= 0:
            return int(watch)
        os.close(watch)
    except (OSError, AttributeError):
        pass
    return None
