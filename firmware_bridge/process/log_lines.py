"""Log records as lines, written by a thread of their own: a terminal that hangs blocks no caller.

Repeated lines, and lines that come too fast, are counted instead of filling a disk.
"""

import contextlib
import json
import logging
import os
import re
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Final, Self

#: Records that may wait: some minutes of a face in trouble.
_MOST_WAITING: Final = 1_000
#: A line that comes again within so long is counted; the count is written afterwards.
_SAME_S: Final = 10.0
#: Lines that are dropped are counted for so long, then their count is written.
_LOST_S: Final = 1.0
#: So many different lines are remembered for that.
_MOST_SAME: Final = 64
#: Lines that may come at once, and a second in the long run.
_MOST_AT_ONCE: Final = 200.0
_MOST_PER_S: Final = 10.0
#: The end of a process waits so long for a terminal that takes no output.
_LAST_WRITES_S: Final = 0.5
#: Characters of one line: room for a name and a reason for every servo of a long chain.
_LONGEST: Final = 4_000
#: What moves a terminal's cursor, changes its colours or turns the writing round.
_CONTROLS: Final = re.compile("[\x00-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]")
#: Of a traceback.
_MOST_LINES: Final = 60
#: https://systemd.io/JOURNAL_NATIVE_PROTOCOL/, and how syslog counts levels.
JOURNAL: Final = "/run/systemd/journal/socket"
_PRIORITY: Final = {"DEBUG": 7, "INFO": 6, "WARNING": 4, "ERROR": 3, "CRITICAL": 2}
_STDERR: Final = 2


def one_line(text: str) -> str:
    """Return a text as one bounded line of a log.

    Line breaks become spaces. Control characters, which may come from a file's name or another
    computer, are escaped.
    """
    bounded = text if len(text) <= _LONGEST else f"{text[:_LONGEST]} ..."
    line = " ".join(bounded.splitlines())
    return _CONTROLS.sub(lambda found: found[0].encode("unicode_escape").decode(), line)


class _LocklessHandler(logging.Handler):
    """A handler that takes no lock of the handlers, which may be held for a whole write."""

    def handle(self, record: logging.LogRecord) -> bool:
        """Emit a record and return True, so that a hung write blocks no other thread."""
        self.emit(record)
        return True


class LogLines(_LocklessHandler):
    """A handler that passes records to another one, each as one line, by a thread; never waits.

    Use it as a context manager. A record that comes too fast or finds the queue full is dropped and
    counted, and the count is written a second later. A repeated line is written once, and then
    every ten seconds with its count.

    The lock guards a few operations in memory: nothing is formatted or written under it.
    """

    def __init__(
        self, target: logging.Handler, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Start the thread that passes records to `target`, whose `emit` may wait for any time."""
        super().__init__()
        self._target = target
        self._clock = clock
        self._waiting: deque[logging.LogRecord] = deque()
        # Of each line that was written lately: until when it is only counted, and its count.
        self._same: dict[str, tuple[float, int, logging.LogRecord]] = {}
        self._tokens, self._tokens_s = _MOST_AT_ONCE, clock()
        self._is_new = threading.Condition()
        # Lines that found no room, and until when they are only counted.
        self._n_lost, self._lost_until_s = 0, 0.0
        self._busy = False
        threading.Thread(target=self._write_all, name="log", daemon=True).start()

    def emit(self, record: logging.LogRecord) -> None:
        """Queue a record's text as one line, formatted now: its arguments may change afterwards.

        A line written within the last 10 s is only counted; one that comes too fast, or finds the
        queue full, is dropped and counted. Both counts are written later. Never waits or raises.
        """
        try:
            text = record.getMessage()
        except Exception:  # a wrong format must not break a caller that is stopping a face
            text = str(record.msg)
        line = one_line(text)
        with self._is_new:
            now_s = self._clock()
            self._queue_counts(now_s)
            # `_same` has, for each recent line: until when it is counted, its count, its record.
            if line in self._same:
                until_s, n, first = self._same[line]
                self._same[line] = until_s, n + 1, first
            elif len(self._waiting) >= _MOST_WAITING or not self._has_token(now_s):
                self._lost_until_s = self._lost_until_s if self._n_lost else now_s + _LOST_S
                self._n_lost += 1
            else:
                record = _changed(record, msg=line)
                if len(self._same) < _MOST_SAME:
                    self._same[line] = now_s + _SAME_S, 0, record
                self._waiting.append(record)
            self._is_new.notify()

    def close(self, timeout_s: float = 0.0) -> None:
        """Wait until all lines and counts are written, for `timeout_s` at most."""
        give_up_s = time.monotonic() + timeout_s
        with self._is_new:
            self._queue_counts(float("inf"))
            self._is_new.notify_all()
            while (self._waiting or self._busy) and (left_s := give_up_s - time.monotonic()) > 0.0:
                self._is_new.wait(left_s)
        super().close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close(_LAST_WRITES_S)

    def _write_all(self) -> None:
        """Pass queued records to the target, one after another, for ever; run by the thread."""
        while True:
            with self._is_new:
                self._busy = False
                self._is_new.notify_all()
                while not self._waiting:
                    self._is_new.wait(self._until_counts_s())
                    self._queue_counts(self._clock())
                record = self._waiting.popleft()
                self._busy = True
            with contextlib.suppress(Exception):  # one line is lost; the next may be written
                self._target.emit(record)

    def _has_token(self, now_s: float) -> bool:
        """Return whether the rate limit allows a line more at `now_s`, and count it if so."""
        gained = _MOST_PER_S * (now_s - self._tokens_s)
        self._tokens, self._tokens_s = min(_MOST_AT_ONCE, self._tokens + gained), now_s
        if self._tokens < 1.0:
            return False
        self._tokens -= 1.0
        return True

    def _until_counts_s(self) -> float | None:
        """Return the seconds until a count of lines is to be written; None: no count is pending."""
        due_s = [until_s for until_s, n, _ in self._same.values() if n]
        due_s += [self._lost_until_s] if self._n_lost else []
        return max(0.0, min(due_s) - self._clock()) if due_s else None

    def _queue_counts(self, now_s: float) -> None:
        """Queue the counts of lost and of repeated lines whose counting time is over at `now_s`."""
        if self._n_lost and now_s >= self._lost_until_s:
            text = f"({self._n_lost} lines were lost: too many at once)"
            level = {"levelno": logging.WARNING, "levelname": "WARNING"}
            self._waiting.append(logging.makeLogRecord({"name": __name__, "msg": text, **level}))
            self._n_lost = 0
        for line, (until_s, n, record) in list(self._same.items()):
            if now_s < until_s:
                continue
            del self._same[line]
            if n:
                self._same[line] = until_s + _SAME_S, 0, record
                text = f"{line} (and {n} times more)"
                self._waiting.append(_changed(record, msg=text, created=time.time()))


def _changed(record: logging.LogRecord, **fields: object) -> logging.LogRecord:
    return logging.makeLogRecord({**record.__dict__, "args": None, **fields})


def write_stderr(text: str) -> None:
    """Write `text` and a line end to descriptor 2, past the lock of sys.stderr.

    Another thread that hangs in a write would hold that lock, and so prevent the exit.
    """
    data = f"{text}\n".encode("utf-8", "backslashreplace")
    while data:
        data = data[os.write(_STDERR, data) :]


class LogWriter(_LocklessHandler):
    """A handler that writes records to journald where stderr leads there, otherwise as lines.

    Parameters
    ----------
    face, side
        Name of the face, and which of its processes logs; empty: no face, its only process.
    start
        Start of each line, as a %-format with a record's attributes.
    write
        Called with the lines for people.
    as_json
        Write one JSON object a line to stderr.

    """

    def __init__(
        self,
        face: str = "",
        side: str = "",
        start: str = "",
        write: Callable[[str], None] = write_stderr,
        *,
        as_json: bool = False,
    ) -> None:
        """Prepare to write; parameters as of the class."""
        super().__init__()
        self._about = {"face": face or None, "side": side or None}
        self._start = start
        self._write = write
        self._as_json = as_json

    def emit(self, record: logging.LogRecord) -> None:
        """Write a record with its traceback; an OSError, as of a closed terminal, is ignored."""
        message, trace = one_line(record.getMessage()), list[str]()
        if record.exc_info:
            trace = logging.Formatter().formatException(record.exc_info).splitlines()[-_MOST_LINES:]
        fields = {
            "time": datetime.fromtimestamp(record.created, UTC).isoformat(timespec="milliseconds"),
            "level": record.levelname.lower(),
            "logger": record.name,
            "message": message,
            **self._about,
            "process": record.process,
            "exception": "\n".join(map(one_line, trace)) or None,
        }
        with contextlib.suppress(OSError):
            if self._as_json:
                write_stderr(json.dumps(fields))
            elif not _sent_to_journal(fields):
                start = self._start % record.__dict__
                self._write("\n".join([start + message, *map(one_line, trace)]))


def _sent_to_journal(fields: Mapping[str, object]) -> bool:
    """Send the `fields` of an entry to journald, and return whether they were sent.

    False: stderr does not lead to the journal (`$JOURNAL_STREAM`, systemd.exec(5)), or sending
    failed.
    """
    stderr = os.fstat(_STDERR)
    if os.environ.get("JOURNAL_STREAM") != f"{stderr.st_dev}:{stderr.st_ino}":
        return False
    level = str(fields["level"]).upper()
    own = {"PRIORITY": _PRIORITY.get(level, 5), "SYSLOG_IDENTIFIER": "lipservo"}
    # Each field: name, line end, the value's length as a 64-bit number, value, line end.
    entry = b""
    for name, value in {**fields, **own}.items():
        data = str(value or "").encode("utf-8", "replace")
        entry += b"%s\n%s%s\n" % (name.upper().encode(), len(data).to_bytes(8, "little"), data)
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as journal:
            journal.sendto(entry, JOURNAL)
    except OSError:
        return False
    return True
