"""What processes of one face owe each other: to die together, and to be on time."""

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


def parent_is_alive(parent: int) -> bool:
    """Whether `parent` is still ours; it may have died before `die_with_parent`."""
    return os.getppid() == parent


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
