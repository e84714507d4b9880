"""How fast servos turn, by where they stood."""

from collections import deque

import numpy as np

from lipsync.arrays import Array

#: Over so much time at least: an encoder step of .09 degrees is then 3 deg/s.
_LEAST_S = 0.025
#: Places further apart than this say nothing about a speed in between.
_MOST_S = 0.2


class ServoSpeeds:
    """Takes places as they are read, gives speeds."""

    def __init__(self) -> None:
        self._read: deque[tuple[float, Array]] = deque(maxlen=8)

    def take(self, time_s: float, positions_deg: Array) -> tuple[float, Array] | None:
        """A reading (n_servos,), NaN for a servo that did not answer.

        The newest time and the speeds (n_servos,) in deg/s then; None until two readings tell.
        A time that was taken before tells nothing new.
        """
        if self._read and time_s <= self._read[-1][0]:
            return None
        found = None
        for before_s, before_deg in reversed(self._read):
            apart_s = time_s - before_s
            if apart_s >= _LEAST_S and len(before_deg) == len(positions_deg):
                if apart_s <= _MOST_S:
                    found = (0.5 * (time_s + before_s), (positions_deg - before_deg) / apart_s)
                break
        self._read.append((time_s, np.array(positions_deg, np.float64)))
        return found
