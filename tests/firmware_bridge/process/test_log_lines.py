"""A log that is not filled by what says the same again and again."""

import json
import logging
import os
import socket
import sys
import threading
import time

import pytest
from places import short_folder

from firmware_bridge.process import log_lines
from firmware_bridge.process.log_lines import LogLines, LogWriter, one_line

PATIENCE_S = 30.0
HOSTILE = "a\x1b[2J\x9b31m\u202eb\x00\r\nc\td"


def record_of(message, *arguments, level=logging.INFO, **fields):
    return logging.makeLogRecord(
        {
            "name": "a.module",
            "levelno": level,
            "levelname": logging.getLevelName(level),
            "msg": message,
            "args": arguments,
            **fields,
        }
    )


class Written(logging.Handler):
    """What was written, and a clock that is set."""

    def __init__(self):
        super().__init__()
        self.now_s = 0.0
        self.lines = []
        self._changed = threading.Condition()
        self.handler = LogLines(self, clock=lambda: self.now_s)

    def log(self, message, *arguments):
        self.handler.handle(record_of(message, *arguments))

    def emit(self, record):
        with self._changed:
            self.lines.append(record.getMessage())
            self._changed.notify()

    def settle(self, n):
        """Until so many lines were written."""
        with self._changed:
            assert self._changed.wait_for(lambda: len(self.lines) >= n, PATIENCE_S)
        return self.lines


@pytest.fixture
def written():
    return Written()


def test_a_line_that_is_repeated_is_written_once_and_then_counted(written):
    for _ in range(1_000):
        written.log("underrun occurred")
    written.log("another")
    assert written.settle(2) == ["underrun occurred", "another"]
    written.now_s = 10.0
    written.log("a third")
    assert written.settle(4)[2:] == ["underrun occurred (and 999 times more)", "a third"]
    written.log("underrun occurred")
    written.now_s = 20.0
    written.log("a fourth")
    assert written.settle(6)[4:] == ["underrun occurred (and 1 times more)", "a fourth"]


def test_a_line_that_comes_again_later_is_written_again(written):
    written.log("gone")
    written.now_s = 10.0
    written.log("gone")
    assert written.settle(2) == ["gone", "gone"]


def test_counts_are_written_at_the_end(written):
    for _ in range(3):
        written.log("gone")
    written.handler.close(PATIENCE_S)
    assert written.lines == ["gone", "gone (and 2 times more)"]


def test_of_different_lines_at_once_some_hundreds_are_written_and_ten_a_second(written):
    for n in range(10_000):
        written.log(f"line {n}")
    assert len(written.settle(200)) == 200
    written.now_s = 1.0
    for n in range(1_000):
        written.log(f"later {n}")
    written.handler.close(PATIENCE_S)
    assert written.lines[200] == "(9800 lines were lost: too many at once)"
    assert written.lines[201:-1] == [f"later {n}" for n in range(10)]
    assert written.lines[-1] == "(990 lines were lost: too many at once)"


def test_foreign_text_stays_one_bounded_line_and_moves_no_cursor():
    assert one_line(HOSTILE) == r"a\x1b[2J\x9b31m\u202eb\x00 c\td"
    assert one_line(one_line(HOSTILE)) == one_line(HOSTILE)
    assert len(one_line("x" * 1_000_000)) < 4_096
    assert one_line("Zähne, [a].wav, 口") == "Zähne, [a].wav, 口"


def test_arguments_are_read_at_once_and_a_mistake_in_a_message_reaches_nobody(written):
    names = ["jaw"]
    written.log("%s", names)
    names.append("lip")
    written.log("%d servos", "no")
    written.log("%s")
    written.handler.close(PATIENCE_S)
    assert written.lines == ["['jaw']", "%d servos", "%s"]


def test_a_target_that_raises_loses_one_line():
    lines = []

    def write(text):
        if text == "first":
            raise ValueError(text)
        lines.append(text)

    with LogLines(LogWriter(write=write)) as log:
        for text in ("first", "second"):
            log.handle(record_of(text))
        log.close(PATIENCE_S)
    assert lines == ["second"]


def test_nothing_that_logs_waits_for_a_terminal_that_stands_still():
    is_over = threading.Event()
    log = LogLines(LogWriter(write=lambda _text: is_over.wait()))
    began_s = time.monotonic()
    for number in range(20_000):
        log.handle(record_of("line %d", number))
    log.close()
    assert time.monotonic() - began_s < PATIENCE_S  # it would be for ever
    is_over.set()


def test_an_interrupted_thread_leaves_no_lock_behind(written):
    """A second signal breaks into anything, a log line for one."""

    class Breaks:
        def __str__(self):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        written.log("%s", Breaks())
    written.log("after it")
    assert written.settle(1) == ["after it"]


def failing():
    try:
        raise ValueError(HOSTILE)
    except ValueError:
        return sys.exc_info()


def test_an_exception_follows_its_line_with_its_traceback(monkeypatch):
    monkeypatch.delenv("JOURNAL_STREAM", raising=False)
    written = []
    LogWriter(start="%(levelname)s %(name)s: ", write=written.append).handle(
        record_of("a fault of %s", "ours", level=logging.ERROR, exc_info=failing())
    )
    first, *trace = written[0].split("\n")
    assert first == "ERROR a.module: a fault of ours"
    assert trace[0].startswith("Traceback")
    assert "\x1b" not in written[0]


def test_json_is_one_object_a_line(capfd):
    writer = LogWriter("tom", "bridge", as_json=True)
    writer.handle(record_of("%s", HOSTILE, level=logging.WARNING, created=0.0, process=7))
    writer.handle(record_of("b", exc_info=failing()))
    first, second = map(json.loads, capfd.readouterr().err.splitlines())
    assert first == {
        "time": "1970-01-01T00:00:00.000+00:00",
        "level": "warning",
        "logger": "a.module",
        "message": one_line(HOSTILE),
        "face": "tom",
        "side": "bridge",
        "process": 7,
        "exception": None,
    }
    assert "ValueError" in second["exception"]


def entry_of(datagram):
    """The fields of an entry, by the protocol's description."""
    fields = {}
    while datagram:
        name, _, rest = datagram.partition(b"\n")
        length = int.from_bytes(rest[:8], "little")
        fields[name.decode()] = rest[8 : 8 + length].decode()
        assert rest[8 + length : 9 + length] == b"\n"
        datagram = rest[9 + length :]
    return fields


@pytest.fixture
def stderr_to_journal(monkeypatch):
    """As systemd starts a service: stderr is the socket that the variable names."""
    stderr = os.fstat(2)
    monkeypatch.setenv("JOURNAL_STREAM", f"{stderr.st_dev}:{stderr.st_ino}")


@pytest.mark.usefixtures("stderr_to_journal")
def test_the_journal_gets_fields(monkeypatch):
    path = str(short_folder() / "journal.sock")
    monkeypatch.setattr(log_lines, "JOURNAL", path)
    lines = []
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as journal:
        journal.bind(path)
        LogWriter("tom", "speech", write=lines.append).handle(
            record_of("a%s", HOSTILE, level=logging.WARNING, exc_info=failing())
        )
        fields = entry_of(journal.recv(100_000))
    assert lines == []
    assert fields["MESSAGE"] == one_line(f"a{HOSTILE}")
    assert fields["EXCEPTION"].startswith("Traceback")
    named = {name: fields[name] for name in ("PRIORITY", "LOGGER", "FACE", "SIDE")}
    assert named == {"PRIORITY": "4", "LOGGER": "a.module", "FACE": "tom", "SIDE": "speech"}
    assert fields["SYSLOG_IDENTIFIER"] == "lipservo"


@pytest.mark.usefixtures("stderr_to_journal")
def test_a_journal_that_is_not_to_be_reached_gets_lines(monkeypatch):
    monkeypatch.setattr(log_lines, "JOURNAL", "/no/such/socket")
    lines = []
    LogWriter(start="bridge: ", write=lines.append).handle(record_of("a"))
    assert lines == ["bridge: a"]


def test_stderr_that_leads_elsewhere_gets_lines_whatever_was_inherited(monkeypatch):
    """A shell in a service: the variable is there, stderr is a terminal's."""
    monkeypatch.setenv("JOURNAL_STREAM", "1:2")
    lines = []
    LogWriter(write=lines.append).handle(record_of("a"))
    assert lines == ["a"]
