"""The connection of a command with the web page that leads it: JSON lines on stdout and stdin.

The dashboard starts the command, such as a calibration, which writes events and reads orders. The
dashboard's process may hang or die at any time. So a thread writes, from a bounded queue, and
another reads; the code that moves servos waits for neither.
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
#: So long `finish` waits for events that are not yet written.
_PATIENCE_S: Final = 1.0


class PageLine:
    """The connection of a command with the web page that leads it: events out, orders in."""

    def __init__(self) -> None:
        self._pending_lines: queue.Queue[str] = queue.Queue(_MOST_WAITING)
        self._orders: queue.Queue[Order] = queue.Queue(_MOST_WAITING)
        for work in (self._write_events, self._read_orders):
            threading.Thread(target=work, name="page", daemon=True).start()

    def tell(self, event: str, **content: Any) -> None:
        """Queue an event for the page; drop the oldest waiting one if the page reads no more."""
        line = json.dumps({"event": event, **content})
        while True:
            with contextlib.suppress(queue.Full):
                return self._pending_lines.put_nowait(line)
            with contextlib.suppress(queue.Empty):
                self._pending_lines.get_nowait()
                self._pending_lines.task_done()

    def finish(self) -> None:
        """Wait until all events are written, a second at most."""
        until_s = time.monotonic() + _PATIENCE_S
        while self._pending_lines.unfinished_tasks and time.monotonic() < until_s:
            time.sleep(0.01)

    def next_order(self, timeout_s: float | None = None) -> Order | None:
        """Return the next order; None if none comes within `timeout_s` (None: wait forever)."""
        with contextlib.suppress(queue.Empty):
            return self._orders.get(timeout=timeout_s)
        return None

    def _write_events(self) -> None:
        while True:
            line = self._pending_lines.get()
            with contextlib.suppress(OSError):  # nobody reads: the servos' end is told otherwise
                os.write(sys.stdout.fileno(), f"{line}\n".encode())
            self._pending_lines.task_done()

    def _read_orders(self) -> None:
        while line := sys.stdin.readline(_LONGEST_ORDER):
            with contextlib.suppress(ValueError, queue.Full):
                self._orders.put_nowait(dict(json.loads(line)))
        self._orders.put(END)
