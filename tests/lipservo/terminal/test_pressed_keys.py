"""Keys while a program goes on: at a pseudo-terminal, and from a script."""

import os
import pty
import termios

import pytest

from lipservo.terminal.keys import PressedKeys


class _Input:
    """Standard input that is a descriptor of ours."""

    def __init__(self, descriptor):
        self._descriptor = descriptor

    def fileno(self):
        return self._descriptor


@pytest.fixture
def terminal(monkeypatch):
    ours, theirs = pty.openpty()
    monkeypatch.setattr("sys.stdin", _Input(theirs))
    yield ours, theirs
    os.close(ours)
    os.close(theirs)


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
    monkeypatch.setattr("sys.stdin", _Input(reader))
    with PressedKeys() as keys:
        assert [keys.next_key(5.0) for _ in range(4)] == [" ", None, "k", "q"]
    os.close(reader)


@pytest.mark.usefixtures("terminal")
def test_a_signal_ends_the_wait():
    woken, wake = os.pipe()
    os.write(wake, b"!")
    with PressedKeys() as keys:
        assert keys.next_key(60.0, woken) is None
    os.close(woken)
    os.close(wake)
