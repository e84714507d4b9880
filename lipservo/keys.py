"""Keys and lines from a person at a terminal, or from a script that plays one."""

import sys

import click

#: What terminals send for arrows, and the keys that mean the same.
_ARROWS = {"\x1b[A": "w", "\x1b[B": "s", "\x1b[C": "d", "\x1b[D": "a"}
_END = "q"


def read_key() -> str:
    """One key; arrows as w, s, d, a; q at the end of a script."""
    if sys.stdin.isatty():
        key = str(click.getchar())
        return _ARROWS.get(key.replace("\x1bO", "\x1b["), key)
    key = sys.stdin.read(1)
    if key == "\x1b":
        key += sys.stdin.read(2)
    return _ARROWS.get(key, key) if key else _END


def read_line(question: str) -> str:
    """One line. Raises EOFError at the end of a script."""
    sys.stderr.write(f"{question}: ")
    sys.stderr.flush()
    line = sys.stdin.readline()
    if not line:
        raise EOFError(f"no answer to: {question}")
    return line.strip()
