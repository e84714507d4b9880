"""A step that a page leads: it tells JSON lines on stdout, and takes orders as such on stdin.

The page's server is another process, which may hang or die at any moment. So a thread of its own
writes, and what waits to be written is bounded; another reads. What moves servos waits for neither.
"""

import contextlib
import json
import os
import queue
import sys
import threading
import time
from collections.abc import Mapping
from typing import Any, Final

Order = Mapping[str, Any]
#: The order that ends a step; given by itself where the page's server is gone.
END: Final[Order] = {"key": "q"}
_MOST_WAITING: Final = 64
_LONGEST_ORDER: Final = 4096
#: What was told is waited for so long at the end.
_PATIENCE_S: Final = 1.0


class PageLine:
    """Both ways between a step and the page that leads it."""

    def __init__(self) -> None:
        self._pending_lines: queue.Queue[str] = queue.Queue(_MOST_WAITING)
        self._orders: queue.Queue[Order] = queue.Queue(_MOST_WAITING)
        for work in (self._write, self._read):
            threading.Thread(target=work, name="page", daemon=True).start()

    def tell(self, event: str, **content: Any) -> None:
        """Send one event; where the page reads no more, the oldest one waiting makes room."""
        line = json.dumps({"event": event, **content})
        while True:
            with contextlib.suppress(queue.Full):
                return self._pending_lines.put_nowait(line)
            with contextlib.suppress(queue.Empty):
                self._pending_lines.get_nowait()
                self._pending_lines.task_done()

    def finish(self) -> None:
        """Wait until all lines are written, a second at most."""
        until_s = time.monotonic() + _PATIENCE_S
        while self._pending_lines.unfinished_tasks and time.monotonic() < until_s:
            time.sleep(0.01)

    def next_order(self, timeout_s: float | None = None) -> Order | None:
        """The next order; None: none came in time."""
        with contextlib.suppress(queue.Empty):
            return self._orders.get(timeout=timeout_s)
        return None

    def _write(self) -> None:
        while True:
            line = self._pending_lines.get()
            with contextlib.suppress(OSError):  # nobody reads: the servos' end is told otherwise
                os.write(sys.stdout.fileno(), f"{line}\n".encode())
            self._pending_lines.task_done()

    def _read(self) -> None:
        while line := sys.stdin.readline(_LONGEST_ORDER):
            with contextlib.suppress(ValueError, queue.Full):
                self._orders.put_nowait(dict(json.loads(line)))
        self._orders.put(END)
