"""Processes that work for this one, and are gone when it is, however it ended."""

import contextlib
import os
import signal
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing.context import BaseContext
from typing import Final

from lipservo_lab.seen_processes import descendants_of

#: Between two looks whether the parent is still there.
_LOOK_S: Final = 0.5


def worker_pool(n_workers: int, context: BaseContext | None = None) -> ProcessPoolExecutor:
    """A pool whose workers end with this process, and with them all that they have started.

    By themselves they would wait for more work for ever; and one that takes signals for what it
    tries out would work on after a signal, too.
    """
    parent = os.getpid()
    return ProcessPoolExecutor(n_workers, context, initializer=_watch, initargs=(parent,))


def _watch(parent: int) -> None:
    threading.Thread(target=_end_with, args=(parent,), name="parent watch", daemon=True).start()


def _end_with(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(_LOOK_S)
    for pid in descendants_of(os.getpid()):
        with contextlib.suppress(OSError):
            os.kill(pid, signal.SIGKILL)
    os._exit(1)
