"""The signals that end a program, and the handlers for them.

Three needs, three handlers; all else a program does with these signals is built on one of them:

* A loop that moves servos must not be broken off in the middle of a tick, but a second signal must
  reach them at once: `firmware_bridge.loop.life_cycle.LifeCycle` has its own handler, which only
  notes the first and raises at the second.
* A process that waits in `select` for others (the supervisor) or runs its own loop without servos
  (speech) must be woken and get their number: `SignalCounter`.
* A command that waits for a person at the keyboard has no loop that could check. It must be broken
  off at once, unless a servo's register is just being written: `DeferredSignals`.
"""

import contextlib
import signal
import socket
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any, Final, Self

#: What a person, a dropped connection, a service manager or a keyboard ends a program with: Ctrl-C,
#: `kill` or a service's stop, a closed terminal, Ctrl-backslash. Windows has the first two.
_NAMES: Final = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT")
STOP_SIGNALS: Final = tuple(signal.Signals[name] for name in _NAMES if hasattr(signal, name))

Handler = Callable[[int, FrameType | None], None]
#: What each signal did before; as `signal.signal` gives it.
PreviousHandlers = dict[signal.Signals, Any]


def install_handler(handler: Handler) -> PreviousHandlers:
    """Install `handler` for all signals that stop a program; return the handlers before it.

    To be called in the main thread. A SIGHUP that the parent ignores, as `nohup` does, stays
    ignored.
    """
    return {
        number: signal.signal(number, handler)
        for number in STOP_SIGNALS
        if number.name != "SIGHUP" or signal.getsignal(number) is not signal.SIG_IGN
    }


def restore_handlers(previous: PreviousHandlers) -> None:
    """Restore the handlers in `previous`, which `install_handler` replaced and returned."""
    for number, handler in previous.items():
        signal.signal(number, handler)


class SignalCounter:
    """A context manager that counts the signals that end a program; for the main thread.

    count: how many have come. last: name of the last one. A handler that only counts cannot leave
    anything half done, wherever it strikes.
    """

    def __init__(self) -> None:
        self.count = 0
        self.last = ""  # its name, for a log
        self._wake, self._woken = socket.socketpair()
        self._wake.setblocking(False)
        self._woken.setblocking(False)

    def fileno(self) -> int:
        """Return a descriptor that is readable once a signal has come."""
        return self._woken.fileno()

    def forget_wake_up(self) -> None:
        """Read the descriptor empty, so that it is readable only at the next signal."""
        with contextlib.suppress(OSError):
            while self._woken.recv(64):
                pass

    def __enter__(self) -> Self:
        self._previous = install_handler(self._note)
        self._previous_fd = signal.set_wakeup_fd(self._wake.fileno(), warn_on_full_buffer=False)
        return self

    def __exit__(self, *exc: object) -> None:
        signal.set_wakeup_fd(self._previous_fd)
        restore_handlers(self._previous)
        self._wake.close()
        self._woken.close()

    def _note(self, number: int, _frame: FrameType | None) -> None:
        self.count += 1
        self.last = signal.Signals(number).name


class StopRequested(Exception):  # noqa: N818 - a wish of a person, not an error
    """Raised when a signal to end the program was received. number: of the signal."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


class DeferredSignals:
    """A context manager that raises StopRequested at a stop signal, or defers it; main thread only.

    Inside `finish_first` the signal is raised at the end of the block. At its exit the previous
    handlers are restored.
    """

    def __init__(self) -> None:
        self._number = 0
        self._is_deferred = False

    @contextlib.contextmanager
    def finish_first(self) -> Iterator[None]:
        """Defer signals while inside: StopRequested is raised only at the end of the block."""
        self._is_deferred = True
        try:
            yield
        finally:
            self._is_deferred = False
        if self._number:
            raise StopRequested(self._number)

    def __enter__(self) -> Self:
        self._previous = install_handler(self._note)
        return self

    def __exit__(self, *exc: object) -> None:
        restore_handlers(self._previous)

    def _note(self, number: int, _frame: FrameType | None) -> None:
        self._number = number
        if not self._is_deferred:
            raise StopRequested(number)
