"""Keys and lines from a person at a terminal, or from a script that plays one."""

import os
import select
import sys
import termios
import tty

from lipsync.errors import UserError

#: What terminals send for arrows, and the keys that mean the same.
_ARROWS = {"\x1b[A": "w", "\x1b[B": "s", "\x1b[C": "d", "\x1b[D": "a"}
_END = "q"
_CTRL_D = "\x04"
#: What becomes of it in a line discipline that still collects lines when it is typed.
_CTRL_D_TYPED_AHEAD = "\x00"
#: The rest of an arrow comes at once; a person who presses Escape alone sends no more.
_ARROW_S = 0.05


class NoAnswerError(UserError):
    """The input ended before a question was answered."""


def read_key() -> str:
    """One key; arrows as w, s, d, a; q at the end of a script."""
    if sys.stdin.isatty():
        key = _terminal_key(sys.stdin.fileno())
    else:
        key = sys.stdin.read(1)
        if key == "\x1b":
            key += sys.stdin.read(2)
    if key in ("", _CTRL_D, _CTRL_D_TYPED_AHEAD):
        return _END
    # In application mode terminals send O in place of the bracket.
    return _ARROWS.get(key.replace("\x1bO", "\x1b["), key)


def read_line(question: str) -> str:
    """One line. Raises NoAnswerError at the end of a script."""
    sys.stderr.write(f"{question}: ")
    sys.stderr.flush()
    line = sys.stdin.readline()
    if not line:
        sys.stderr.write("\n")
        raise NoAnswerError(f"the input ended before an answer to: {question}")
    return line.strip()


def _terminal_key(terminal: int) -> str:
    """One key without Enter, unseen; "" when the terminal is gone. Ctrl-C stays a signal."""
    before = termios.tcgetattr(terminal)
    try:
        tty.setcbreak(terminal, termios.TCSANOW)  # the default forgets keys typed ahead
        key = os.read(terminal, 1)
        if key == b"\x1b" and select.select([terminal], [], [], _ARROW_S)[0]:
            key += os.read(terminal, 2)
    except OSError:  # EIO: hung up
        return ""
    finally:
        termios.tcsetattr(terminal, termios.TCSADRAIN, before)
    return key.decode(errors="replace")
