"""Keys from a real terminal, which is a pseudo-terminal here, and from a script."""

import io
import os
import pty
import sys
from collections.abc import Iterator

import pytest

from lipservo.terminal.keys import NoAnswerError, read_key, read_line


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """The other end of a terminal that is the standard input."""
    ours, theirs = pty.openpty()
    with os.fdopen(theirs, "r") as stdin:
        monkeypatch.setattr(sys, "stdin", stdin)
        yield ours
    os.close(ours)


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        (b"x", "x"),
        (b"\x1b[A", "w"),
        (b"\x1bOB", "s"),
        (b"\x1b[C", "d"),
        (b"\x1b[D", "a"),
        (b"\x1b", "\x1b"),
        (b"\x04", "q"),
    ],
)
def test_one_key_is_read_without_enter(terminal, typed, meant):
    os.write(terminal, typed)
    assert read_key() == meant


def test_keys_typed_ahead_come_one_after_the_other(terminal):
    os.write(terminal, b"dd\x1b[A")
    assert [read_key(), read_key(), read_key()] == ["d", "d", "w"]


def test_a_script_of_keys_ends_with_q(monkeypatch):
    monkeypatch.setattr(sys, "stdin", io.StringIO("d\x1b[A"))
    assert [read_key(), read_key(), read_key()] == ["d", "w", "q"]


def test_a_script_without_an_answer_is_told_to_whom_it_was_a_question(monkeypatch, capsys):
    monkeypatch.setattr(sys, "stdin", io.StringIO("1 2 3\n"))
    assert read_line("where") == "1 2 3"
    with pytest.raises(NoAnswerError, match="ended before an answer to: and then"):
        read_line("and then")
    assert capsys.readouterr().err.startswith("where: ")
