"""Processes as the kernel shows them: who started whom, how long each ran, in which state it is."""

import contextlib
import os
from pathlib import Path
from typing import Final

_TICKS_S: Final = os.sysconf("SC_CLK_TCK")


def processor_s(pid: int) -> float:
    """Return a process's processor time so far, s; 0 where it has ended."""
    fields = _stat(pid)
    return (int(fields[11]) + int(fields[12])) / _TICKS_S if fields else 0.0


def state_of(pid: int) -> str:
    """Return a process's state as one letter: R, S, T and so on; empty where it has ended."""
    fields = _stat(pid)
    return "" if not fields or fields[0] in "ZX" else fields[0]


def children_of(pid: int) -> list[int]:
    """Return the processes that a process started, by whichever of its threads."""
    found: list[int] = []
    for children in Path(f"/proc/{pid}/task").glob("*/children"):
        with contextlib.suppress(OSError):
            found += map(int, children.read_text().split())
    return found


def child_of(pid: int, word: str) -> int | None:
    """Return the child process with `word` as an argument of its command line; None: no such."""
    for child in children_of(pid):
        with contextlib.suppress(OSError):
            if word in Path(f"/proc/{child}/cmdline").read_text(errors="replace").split("\0"):
                return child
    return None


def descendants_of(pid: int) -> list[int]:
    """Return all processes that a process started, and those that these started."""
    return [each for child in children_of(pid) for each in (child, *descendants_of(child))]


def _stat(pid: int) -> list[str]:
    """Return the fields of /proc/PID/stat from the state on; empty if the process has ended."""
    with contextlib.suppress(OSError):
        return Path(f"/proc/{pid}/stat").read_text(errors="replace").rpartition(")")[2].split()
    return []
