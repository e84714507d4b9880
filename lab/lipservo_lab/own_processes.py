"""Processes that a bench starts: they end with their block, and with the bench in any case."""

import ctypes
import signal
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any, Final

#: Loaded here, since a process between fork and exec must not load anything.
_LIBC: Final = ctypes.CDLL(None)
_PR_SET_PDEATHSIG: Final = 1  # linux/prctl.h
_END_S: Final = 30.0


@contextmanager
def started(command: Sequence[str], **options: Any) -> "Iterator[subprocess.Popen[Any]]":
    """Start a process that is ended after the block. options: of `subprocess.Popen`."""
    process = started_alone(command, **options)
    with process:
        try:
            yield process
        finally:
            end(process)


def started_alone(
    command: Sequence[str], sent: signal.Signals = signal.SIGTERM, **options: Any
) -> "subprocess.Popen[Any]":
    """Start a process to which the kernel sends a signal when this one ends, killed or not."""
    ask_for_signal = partial(_LIBC.prctl, _PR_SET_PDEATHSIG, int(sent))
    return subprocess.Popen(command, preexec_fn=ask_for_signal, **options)


def end(process: "subprocess.Popen[Any]", patience_s: float = _END_S) -> None:
    """End a process by SIGTERM, and by SIGKILL where that does not end it in time."""
    process.terminate()
    try:
        process.wait(patience_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
