"""Keys at a terminal, which is a pseudo-terminal here, and from a script: waited for, or not."""

import io
import os
import pty
import termios

import pytest

from lipservo.terminal.keys import NoAnswerError, PressedKeys, read_key, read_line


@pytest.fixture
def terminal(monkeypatch):
    """A terminal that is the standard input: its other end, and its own."""
    ours, theirs = pty.openpty()
    with os.fdopen(theirs, "r") as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        yield ours, theirs
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
    os.write(terminal[0], typed)
    assert read_key() == meant


def test_keys_typed_ahead_come_one_after_the_other(terminal):
    os.write(terminal[0], b"dd\x1b[A")
    assert [read_key(), read_key(), read_key()] == ["d", "d", "w"]


def test_a_script_of_keys_ends_with_q(monkeypatch):
    monkeypatch.setattr("sys.stdin", io.StringIO("d\x1b[A"))
    assert [read_key(), read_key(), read_key()] == ["d", "w", "q"]


def test_a_script_without_an_answer_is_told_to_whom_it_was_a_question(monkeypatch, capsys):
    monkeypatch.setattr("sys.stdin", io.StringIO("1 2 3\n"))
    assert read_line("where") == "1 2 3"
    with pytest.raises(NoAnswerError, match="ended before an answer to: and then"):
        read_line("and then")
    assert capsys.readouterr().err.startswith("where: ")


def test_a_key_comes_without_enter_and_the_terminal_is_left_as_it_was(terminal):
    ours, theirs = terminal
    before = termios.tcgetattr(theirs)
    with PressedKeys() as keys:
        assert keys.next_key(0.0) is None
        os.write(ours, b"S ")
        assert [keys.next_key(5.0), keys.next_key(5.0)] == ["s", " "]
    assert termios.tcgetattr(theirs) == before


def test_an_arrow_is_not_taken_for_its_last_letter(terminal):
    ours, _ = terminal
    with PressedKeys() as keys:
        os.write(ours, b"\x1b[B")
        assert keys.next_key(5.0) is None
        os.write(ours, b"k")
        assert keys.next_key(5.0) == "k"


def test_a_script_ends_with_the_key_for_the_end(monkeypatch):
    reader, writer = os.pipe()
    os.write(writer, b" \nk")
    os.close(writer)
    with os.fdopen(reader) as stdin, monkeypatch.context() as patch:
        patch.setattr("sys.stdin", stdin)
        with PressedKeys() as keys:
            assert [keys.next_key(5.0) for _ in range(4)] == [" ", None, "k", "q"]


@pytest.mark.usefixtures("terminal")
def test_a_signal_ends_the_wait():
    woken, wake = os.pipe()
    os.write(wake, b"!")
    with PressedKeys() as keys:
        assert keys.next_key(60.0, woken) is None
    os.close(woken)
    os.close(wake)
