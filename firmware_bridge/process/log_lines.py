"""Lines for a log, written by a thread of their own: a terminal that stands still stops nobody."""

import contextlib
import os
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Final, Self

#: Lines that may wait: some minutes of a face in trouble.
_MOST_WAITING: Final = 1_000
_STDERR: Final = 2


class LogLines:
    """Call it with a line; it returns at once. Use it as a context manager.

    What finds no room is dropped and counted, and the count is written as soon as there is room.
    """

    def __init__(
        self, fd: int = _STDERR, prefix: str = "", write: Callable[[str], None] | None = None
    ) -> None:
        """prefix: what every line begins with, such as the name of the process.

        write: takes each line in place of `fd`, where something else draws on the terminal, too.
        """
        self._fd = fd
        self._prefix = prefix
        self._write_line = write or self._write
        self._waiting: deque[str] = deque()
        self._is_new = threading.Condition()
        self._n_dropped = 0
        self._busy = False
        threading.Thread(target=self._write_all, name="log", daemon=True).start()

    def __call__(self, line: str) -> None:
        """One line for the log; line breaks in it become spaces."""
        with self._is_new:
            if len(self._waiting) >= _MOST_WAITING:
                self._n_dropped += 1
                return
            self._waiting.append(" ".join(line.splitlines()))
            self._is_new.notify()

    def close(self, timeout_s: float = 0.5) -> None:
        """Wait until all is written, and no longer than `timeout_s`."""
        give_up_s = time.monotonic() + timeout_s
        with self._is_new:
            while (self._waiting or self._busy) and (left_s := give_up_s - time.monotonic()) > 0.0:
                self._is_new.wait(left_s)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _write_all(self) -> None:
        while True:
            with self._is_new:
                self._busy = False
                self._is_new.notify_all()
                while not self._waiting:
                    self._is_new.wait()
                line, dropped = self._waiting.popleft(), self._n_dropped
                self._n_dropped = 0
                self._busy = True
            if dropped:
                line = f"({dropped} lines were lost: nobody read them) {line}"
            self._write_line(f"{self._prefix}{line}")

    def _write(self, line: str) -> None:
        data = f"{line}\n".encode("utf-8", "replace")
        # Not through sys.stderr: its lock, held by a thread that waits, would stop the exit.
        with contextlib.suppress(OSError):
            while data:
                data = data[os.write(self._fd, data) :]
