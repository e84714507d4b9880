"""What processes of one face owe each other: to die together, and to be on time."""

import contextlib
import ctypes
import gc
import os
import signal
import socket
from collections.abc import Iterator
from types import FrameType
from typing import Final, Self

#: What asks a program to end: Ctrl-C, a service's stop, a closed terminal, Ctrl-backslash.
STOP_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)

#: linux/prctl.h: the signal that a process gets when its parent dies.
_PR_SET_PDEATHSIG: Final = 1
#: Above everything ordinary, below the kernel's own threads. Ours.
_FIFO_PRIORITY: Final = 50


def die_with_parent(number: int = signal.SIGTERM) -> None:
    """Ask the kernel for a signal when the parent dies. Nothing happens where it cannot."""
    with contextlib.suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, number)


def write_from_background() -> None:
    """Go on when a terminal lets only its foreground write; a child in a group of its own may not.

    See `stty tostop`. Stopped there, a bridge would be taken for one that hangs.
    """
    signal.signal(signal.SIGTTOU, signal.SIG_IGN)


@contextlib.contextmanager
def on_time() -> Iterator[bool]:
    """`run_on_time` for a while; gives back the ordinary scheduling."""
    granted = run_on_time()
    try:
        yield granted
    finally:
        if granted:
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def run_on_time() -> bool:
    """First-in-first-out scheduling if permitted, and no more collection of garbage there is.

    Whether the scheduling was granted.
    """
    gc.collect()
    gc.freeze()
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_FIFO_PRIORITY))
    except (OSError, AttributeError):
        return False
    return True


class StopSignals:
    """Counts the signals that ask for an end. Use it as a context manager, in the main thread.

    A handler that only counts cannot leave anything half done, wherever it strikes.
    """

    def __init__(self) -> None:
        self.count = 0
        self.last = ""  # its name, for a log
        self._wake, self._woken = socket.socketpair()
        self._wake.setblocking(False)
        self._woken.setblocking(False)

    def fileno(self) -> int:
        """Readable once a signal has come."""
        return self._woken.fileno()

    def forget_wake_up(self) -> None:
        """Be readable only at the next signal."""
        with contextlib.suppress(OSError):
            while self._woken.recv(64):
                pass

    def __enter__(self) -> Self:
        self._previous = {number: signal.signal(number, self._note) for number in STOP_SIGNALS}
        self._previous_fd = signal.set_wakeup_fd(self._wake.fileno(), warn_on_full_buffer=False)
        return self

    def __exit__(self, *exc: object) -> None:
        signal.set_wakeup_fd(self._previous_fd)
        for number, handler in self._previous.items():
            signal.signal(number, handler)
        self._wake.close()
        self._woken.close()

    def _note(self, number: int, _frame: FrameType | None) -> None:
        self.count += 1
        self.last = signal.Signals(number).name
