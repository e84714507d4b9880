"""Keys of somebody at a terminal while a program goes on, or a script that plays one."""

import os
import select
import sys
import termios
import tty
from types import TracebackType
from typing import Any, Self

_ENDS = ("", "\x04")
#: The rest of an arrow or a function key comes at once; a lone Escape has none.
_ESCAPE, _ESCAPE_S, _LONGEST_ESCAPE = "\x1b", 0.05, 8


class PressedKeys:
    """Single keys without Enter, unseen. Use it as a context manager: it holds the terminal.

    A script's keys come one at a time, line ends left out; at its end comes `end`. Keys that are
    more than a character, arrows for one, are no keys here.
    """

    def __init__(self, end: str = "q") -> None:
        self._end = end
        self._input = sys.stdin.fileno()
        self._before: list[Any] | None = None

    def next_key(self, timeout_s: float, wake: Any = None) -> str | None:
        """The next key in lower case, or None after so long, or once `wake` is readable."""
        sources = [self._input] if wake is None else [self._input, wake]
        if self._input not in select.select(sources, [], [], timeout_s)[0]:
            return None
        try:
            key = os.read(self._input, 1).decode(errors="replace")
        except OSError:  # EIO: hung up
            key = ""
        if key in _ENDS:
            return self._end
        if key == _ESCAPE:
            if select.select([self._input], [], [], _ESCAPE_S)[0]:
                os.read(self._input, _LONGEST_ESCAPE)
            return None
        if key == "\n" and self._before is None:
            return None
        return key.lower()

    def __enter__(self) -> Self:
        if os.isatty(self._input):
            self._before = termios.tcgetattr(self._input)
            tty.setcbreak(self._input, termios.TCSANOW)  # the default forgets keys typed ahead
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        where: TracebackType | None,
    ) -> None:
        if self._before is not None:
            termios.tcsetattr(self._input, termios.TCSADRAIN, self._before)
