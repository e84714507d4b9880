"""Lines for a log, written by a thread of their own: a terminal that stands still stops nobody.

What says the same again and again, and what says too much, does not fill a disk either.
"""

import contextlib
import os
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Final, Self

#: Lines that may wait: some minutes of a face in trouble.
_MOST_WAITING: Final = 1_000
#: A line that comes again within so long is counted; the count is written afterwards.
_SAME_S: Final = 10.0
#: Lines without room are counted for so long.
_LOST_S: Final = 1.0
#: So many different lines are remembered for that.
_MOST_SAME: Final = 64
#: Lines that may come at once, and a second in the long run.
_MOST_AT_ONCE: Final = 200.0
_MOST_PER_S: Final = 10.0
_STDERR: Final = 2


class LogLines:
    """Call it with a line; it returns at once. Use it as a context manager.

    What finds no room is dropped and counted, and the count is written a second later. A line that
    is repeated is written once, and then every ten seconds with how often it came.
    """

    def __init__(
        self,
        fd: int = _STDERR,
        prefix: str = "",
        write: Callable[[str], None] | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """prefix: what every line begins with, such as the name of the process.

        write: takes each line in place of `fd`, where something else draws on the terminal, too.
        """
        self._fd = fd
        self._prefix = prefix
        self._write_line = write or self._write
        self._clock = clock
        self._waiting: deque[str] = deque()
        # Of each line that was written lately: until when it is only counted, and its count.
        self._same: dict[str, tuple[float, int]] = {}
        self._tokens, self._tokens_s = _MOST_AT_ONCE, clock()
        self._is_new = threading.Condition()
        # Lines that found no room, and until when they are only counted.
        self._n_lost, self._lost_until_s = 0, 0.0
        self._busy = False
        threading.Thread(target=self._write_all, name="log", daemon=True).start()

    def __call__(self, line: str) -> None:
        """One line for the log; line breaks in it become spaces."""
        line = " ".join(line.splitlines())
        with self._is_new:
            now_s = self._clock()
            self._tell_counts(now_s)
            if line in self._same:
                until_s, n = self._same[line]
                self._same[line] = until_s, n + 1
            elif len(self._waiting) >= _MOST_WAITING or not self._has_token(now_s):
                self._lost_until_s = self._lost_until_s if self._n_lost else now_s + _LOST_S
                self._n_lost += 1
            else:
                if len(self._same) < _MOST_SAME:
                    self._same[line] = now_s + _SAME_S, 0
                self._waiting.append(line)
            self._is_new.notify()

    def close(self, timeout_s: float = 0.5) -> None:
        """Wait until all is written, and no longer than `timeout_s`."""
        give_up_s = time.monotonic() + timeout_s
        with self._is_new:
            self._tell_counts(float("inf"))
            self._is_new.notify_all()
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
                    self._is_new.wait(self._until_counts_s())
                    self._tell_counts(self._clock())
                line = self._waiting.popleft()
                self._busy = True
            self._write_line(f"{self._prefix}{line}")

    def _has_token(self, now_s: float) -> bool:
        """Whether one more line may be written now; then it counts as written."""
        gained = _MOST_PER_S * (now_s - self._tokens_s)
        self._tokens, self._tokens_s = min(_MOST_AT_ONCE, self._tokens + gained), now_s
        if self._tokens < 1.0:
            return False
        self._tokens -= 1.0
        return True

    def _until_counts_s(self) -> float | None:
        """How long until a count is to be written; None: there is none."""
        due_s = [until_s for until_s, n in self._same.values() if n]
        due_s += [self._lost_until_s] if self._n_lost else []
        return max(0.0, min(due_s) - self._clock()) if due_s else None

    def _tell_counts(self, now_s: float) -> None:
        """Of lines whose time is over: write how often they came again, or forget them."""
        if self._n_lost and now_s >= self._lost_until_s:
            self._waiting.append(f"({self._n_lost} lines were lost: too many at once)")
            self._n_lost = 0
        for line, (until_s, n) in list(self._same.items()):
            if now_s < until_s:
                continue
            del self._same[line]
            if n:
                self._same[line] = until_s + _SAME_S, 0
                self._waiting.append(f"{line} (and {n} times more)")

    def _write(self, line: str) -> None:
        data = f"{line}\n".encode("utf-8", "replace")
        # Not through sys.stderr: its lock, held by a thread that waits, would stop the exit.
        with contextlib.suppress(OSError):
            while data:
                data = data[os.write(self._fd, data) :]
