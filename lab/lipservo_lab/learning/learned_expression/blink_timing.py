"""Involuntary blinks: log-normal intervals, and how far a lid is shut in the course of one.

Log-normal intervals: Le, Ma and Deng 2012. Down 90 ms, shut 20 ms, up 240 ms: VanderWerf and
others, J. Neurophysiology 89(5), 2003, after a second source.
"""

import math

import numpy as np

_CLOSE_S, _SHUT_S, _OPEN_S = 0.090, 0.020, 0.240
BLINK_S = _CLOSE_S + _SHUT_S + _OPEN_S
#: From the start of one blink to the next.
LEAST_INTERVAL_S = 0.4
_MOST_INTERVAL_S = 60.0


def shut_share(since_s: float) -> float:
    """How far the lid is shut (0 to 1) so long after a blink began; smooth at both ends."""
    if not 0.0 < since_s < BLINK_S:
        return 0.0
    if since_s < _CLOSE_S:
        return _smooth(since_s / _CLOSE_S)
    return 1.0 - _smooth(max(0.0, since_s - _CLOSE_S - _SHUT_S) / _OPEN_S)


def _smooth(share: float) -> float:
    return share * share * (3.0 - 2.0 * share)


class BlinkTiming:
    """When blinks begin. log_mean, log_sd: of the natural logarithm of intervals in seconds."""

    def __init__(self, log_mean: float, log_sd: float, rng: np.random.Generator) -> None:
        self._log_mean, self._log_sd, self._rng = log_mean, log_sd, rng
        self._began_s = -math.inf
        self._next_s: float | None = None

    def shut(self, time_s: float) -> float:
        """How far the lids are shut at a time; ask in order."""
        if self._next_s is None:
            # In the middle of an interval: nobody begins by blinking.
            self._next_s = time_s + 0.5 * self._interval_s()
        if time_s >= self._next_s:
            self._began_s = self._next_s
            # Time may have jumped over many blinks.
            self._next_s = max(time_s, self._began_s + self._interval_s())
        return shut_share(time_s - self._began_s)

    def _interval_s(self) -> float:
        drawn = math.exp(min(10.0, self._log_mean + self._log_sd * self._rng.standard_normal()))
        return min(_MOST_INTERVAL_S, max(LEAST_INTERVAL_S, drawn))
