"""Processes of one face die together, and run on time."""

import contextlib
import ctypes
import gc
import os
import signal
from collections.abc import Iterator
from typing import Final

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
