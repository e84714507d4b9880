"""SIGINT, SIGTERM, SIGHUP and SIGQUIT as an exception, at a moment that does no harm."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Final

STOP_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)


class StopRequested(Exception):  # noqa: N818 - a wish of a person, not an error
    """Somebody asked the program to end. number: of the signal."""

    def __init__(self, number: int) -> None:
        super().__init__(signal.Signals(number).name)
        self.number = number


class HeldSignals:
    """Raises StopRequested at once, or after what must not be left half-done."""

    def __init__(self) -> None:
        self._number = 0
        self._busy = False

    @contextmanager
    def finish_first(self) -> Iterator[None]:
        """What happens inside is finished; only then StopRequested is raised."""
        self._busy = True
        try:
            yield
        finally:
            self._busy = False
        if self._number:
            raise StopRequested(self._number)

    def _note(self, number: int, frame: FrameType | None) -> None:
        del frame
        self._number = number
        if not self._busy:
            raise StopRequested(number)


@contextmanager
def held_signals() -> Iterator[HeldSignals]:
    """Catch the four signals until the block ends; then they do what they did before."""
    held = HeldSignals()
    before = {number: signal.signal(number, held._note) for number in STOP_SIGNALS}
    try:
        yield held
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
