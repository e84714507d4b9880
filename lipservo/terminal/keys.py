"""Keys and lines from stdin, a person's terminal or a script.

`read_key` and `read_line` wait; `PressedKeys` has a time limit, for programs that do other work.
"""

import os
import select
import sys
import termios
import tty
from types import TracebackType
from typing import Any, Self

from lipsync.errors import UserError

#: What terminals send for arrows, and the keys that mean the same.
_ARROWS = {"\x1b[A": "w", "\x1b[B": "s", "\x1b[C": "d", "\x1b[D": "a"}
_END = "q"
_CTRL_D = "\x04"
#: What becomes of it in a line discipline that still collects lines when it is typed.
_CTRL_D_TYPED_AHEAD = "\x00"
#: The rest of an arrow or a function key comes at once; a lone Escape has none.
_ESCAPE, _ESCAPE_S, _LONGEST_ESCAPE = "\x1b", 0.05, 8


class NoAnswerError(UserError):
    """The input ended before a question was answered."""


def read_key() -> str:
    """Wait for a key and return it; arrows up, down, right, left as w, s, d, a.

    Ctrl-D and the input's end are returned as q.
    """
    if sys.stdin.isatty():
        key = _read_terminal_key(sys.stdin.fileno())
    else:
        key = sys.stdin.read(1)
        if key == "\x1b":
            key += sys.stdin.read(2)
    if key in ("", _CTRL_D, _CTRL_D_TYPED_AHEAD):
        return _END
    # In application mode terminals send O in place of the bracket.
    return _ARROWS.get(key.replace("\x1bO", "\x1b["), key)


def read_line(question: str) -> str:
    """Print a question and return the line read. Raises NoAnswerError at the input's end."""
    sys.stderr.write(f"{question}: ")
    sys.stderr.flush()
    line = sys.stdin.readline()
    if not line:
        sys.stderr.write("\n")
        raise NoAnswerError(f"the input ended before an answer to: {question}")
    return line.strip()


def _read_terminal_key(terminal_fd: int) -> str:
    """Wait for a key from a terminal, without Enter or echo; an arrow is three characters.

    Return "" if the terminal is gone. Ctrl-C stays a signal.
    """
    previous_mode = termios.tcgetattr(terminal_fd)
    try:
        tty.setcbreak(terminal_fd, termios.TCSANOW)  # the default forgets keys typed ahead
        key = os.read(terminal_fd, 1)
        if key == b"\x1b" and select.select([terminal_fd], [], [], _ESCAPE_S)[0]:
            key += os.read(terminal_fd, 2)
    except OSError:  # EIO: hung up
        return ""
    finally:
        termios.tcsetattr(terminal_fd, termios.TCSADRAIN, previous_mode)
    return key.decode(errors="replace")


class PressedKeys:
    """Single keys from stdin, without Enter or echo, inside a `with` block.

    A script's keys come one at a time, line ends left out; at its end `end` comes as a key. Keys of
    more than one character, such as arrows, are ignored.
    """

    def __init__(self, end: str = "q") -> None:
        self._end = end
        self._input_fd = sys.stdin.fileno()
        self._previous_mode: list[Any] | None = None

    def next_key(self, timeout_s: float, wake: Any = None) -> str | None:
        """Return the next key in lower case; the constructor's `end` at Ctrl-D or the input's end.

        None: no key came in `timeout_s`, the key is ignored, or the file `wake` became readable.
        """
        sources = [self._input_fd] if wake is None else [self._input_fd, wake]
        if self._input_fd not in select.select(sources, [], [], timeout_s)[0]:
            return None
        try:
            key = os.read(self._input_fd, 1).decode(errors="replace")
        except OSError:  # EIO: hung up
            key = ""
        if key in ("", _CTRL_D):
            return self._end
        if key == _ESCAPE:
            if select.select([self._input_fd], [], [], _ESCAPE_S)[0]:
                os.read(self._input_fd, _LONGEST_ESCAPE)
            return None
        if key == "\n" and self._previous_mode is None:  # no terminal: the line end of a script
            return None
        return key.lower()

    def __enter__(self) -> Self:
        if os.isatty(self._input_fd):
            self._previous_mode = termios.tcgetattr(self._input_fd)
            tty.setcbreak(self._input_fd, termios.TCSANOW)  # the default forgets keys typed ahead
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        where: TracebackType | None,
    ) -> None:
        """Restore the terminal's mode; stdin that is no terminal needs nothing."""
        if self._previous_mode is not None:
            termios.tcsetattr(self._input_fd, termios.TCSADRAIN, self._previous_mode)
