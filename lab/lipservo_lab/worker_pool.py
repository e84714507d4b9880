"""Worker processes that end with this process, however it ended."""

import contextlib
import os
import signal
import threading
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing.context import BaseContext
from typing import Final

from lipservo_lab.seen_processes import descendants_of

#: Pause between two checks of whether the parent still exists.
_LOOK_S: Final = 0.5


def worker_pool(n_workers: int, context: BaseContext | None = None) -> ProcessPoolExecutor:
    """Return a pool whose workers end with this process, with all that they have started.

    On their own they would wait for work for ever; and a worker that handles signals itself would
    go on after one.
    """
    parent = os.getpid()
    return ProcessPoolExecutor(n_workers, context, initializer=_watch_parent, initargs=(parent,))


def _watch_parent(parent: int) -> None:
    """Start the thread that ends this worker when the parent has ended."""
    threading.Thread(target=_end_after, args=(parent,), name="parent watch", daemon=True).start()


def _end_after(parent: int) -> None:
    """Wait until the parent has ended; then kill all descendants and end this process."""
    while os.getppid() == parent:
        time.sleep(_LOOK_S)
    for pid in descendants_of(os.getpid()):
        with contextlib.suppress(OSError):
            os.kill(pid, signal.SIGKILL)
    os._exit(1)
