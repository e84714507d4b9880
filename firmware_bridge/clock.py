"""Time as an argument, and the grid of ticks that every loop runs on."""

import math
import time
from collections.abc import Iterator
from typing import Protocol


class Clock(Protocol):
    """A source of seconds that never run backwards, from an arbitrary zero."""

    def now(self) -> float:
        """Return the seconds since this clock's zero."""

    def sleep_until(self, time_s: float) -> None:
        """Return at `time_s` or later, never earlier; at once when that time has passed."""


class MonotonicClock:
    """The computer's monotonic clock, which setting the date does not change."""

    #: Seconds; the function itself, since a tick looks a dozen times.
    now = staticmethod(time.monotonic)

    def sleep_until(self, time_s: float) -> None:
        """Sleep the thread until `time_s`; a sleep that ends early is resumed."""
        while (remaining_s := time_s - time.monotonic()) > 0.0:
            time.sleep(remaining_s)


class ManualClock:
    """A clock that moves only when a test or bench sets it: hours pass at once, reproducibly."""

    def __init__(self, start_s: float = 0.0) -> None:
        self._now_s = start_s

    def now(self) -> float:
        """Return the time to which the clock was set last, in s."""
        return self._now_s

    def sleep_until(self, time_s: float) -> None:
        """Set the clock to `time_s`; leave it unchanged when that time has passed."""
        self._now_s = max(self._now_s, time_s)

    def advance(self, seconds: float) -> None:
        """Set the clock on by `seconds`. Raises ValueError when `seconds` is negative."""
        if seconds < 0.0:
            raise ValueError(f"a clock cannot go back by {seconds} s")
        self._now_s += seconds


def ticks(clock: Clock, rate_hz: float) -> Iterator[tuple[float, int]]:
    """Yield (tick time, ticks missed just before it) on a fixed grid, for ever.

    The grid starts when the first tick is requested; tick n is at start + n / rate_hz (> 0). After
    a stall the newest tick that is due is yielded, once, and the missed ticks are counted: servos
    want one fresh goal, not a burst of old goals.
    """
    start_s = clock.now()
    due = 0
    while True:
        clock.sleep_until(start_s + due / rate_hz)
        now_s, newest = clock.now(), due
        if now_s >= start_s + (due + 1) / rate_hz:
            newest = _newest_due(now_s, start_s, rate_hz)
        yield start_s + newest / rate_hz, newest - due
        due = newest + 1


def _newest_due(now_s: float, start_s: float, rate_hz: float) -> int:
    """Return the number of the last tick at or before `now_s` on the grid from `start_s`.

    The grid has `rate_hz` ticks a second. The guess is compared with the times that `ticks` yields:
    once the clock shows days it may be one off by rounding, and a tick would be yielded twice.
    """
    guess = math.floor((now_s - start_s) * rate_hz) + 1
    while start_s + guess / rate_hz > now_s:
        guess -= 1
    return guess
