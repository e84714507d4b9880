"""A log that is not filled by what says the same again and again."""

import threading

import pytest

from firmware_bridge.process.log_lines import LogLines

PATIENCE_S = 30.0


class Written:
    """What was written, and a clock that is set."""

    def __init__(self):
        self.now_s = 0.0
        self.lines = []
        self._changed = threading.Condition()
        self.log = LogLines(write=self._write, clock=lambda: self.now_s)

    def _write(self, line):
        with self._changed:
            self.lines.append(line)
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
    written.log.close(PATIENCE_S)
    assert written.lines == ["gone", "gone (and 2 times more)"]


def test_of_different_lines_at_once_some_hundreds_are_written_and_ten_a_second(written):
    for n in range(10_000):
        written.log(f"line {n}")
    assert len(written.settle(200)) == 200
    written.now_s = 1.0
    for n in range(1_000):
        written.log(f"later {n}")
    written.log.close(PATIENCE_S)
    assert written.lines[200] == "(9800 lines were lost: too many at once)"
    assert written.lines[201:-1] == [f"later {n}" for n in range(10)]
    assert written.lines[-1] == "(990 lines were lost: too many at once)"
