"""The head never holds still while people talk: a slow wandering about where it should be."""

import math
from random import Random

from lipsync.expression.cue import CUE_PERIOD_S

#: Of pitch, yaw and roll: how fast it forgets where it was, and its standard deviation.
_TAUS_S = (1.2, 1.5, 1.8)
_SDS_DEG = (1.8, 2.2, 1.3)
#: Who listens moves half as much.
_LISTENING_SHARE = 0.5


class HeadDrift:
    """An Ornstein-Uhlenbeck process for each axis, do = -o/tau dt + sigma sqrt(2/tau) dW.

    Stepped exactly (Gillespie, Physical Review E 54, 1996, eq. 1.9), at standard deviation 1, so
    that its size may change at any time without a jump.
    """

    def __init__(self, random: Random) -> None:
        self._random = random
        self._kept = tuple(math.exp(-CUE_PERIOD_S / tau_s) for tau_s in _TAUS_S)
        self._new = tuple(math.sqrt(1.0 - kept * kept) for kept in self._kept)
        self._at = (0.0, 0.0, 0.0)

    def step(self, talking: float) -> tuple[float, float, float]:
        """Pitch, yaw and roll in degrees one cue later; talking: 0 to 1."""
        (pitch, yaw, roll), (kept_0, kept_1, kept_2) = self._at, self._kept
        new_0, new_1, new_2 = self._new
        gauss = self._random.gauss
        pitch = kept_0 * pitch + new_0 * gauss(0.0, 1.0)
        yaw = kept_1 * yaw + new_1 * gauss(0.0, 1.0)
        roll = kept_2 * roll + new_2 * gauss(0.0, 1.0)
        self._at = (pitch, yaw, roll)
        size = _LISTENING_SHARE + (1.0 - _LISTENING_SHARE) * talking
        return size * _SDS_DEG[0] * pitch, size * _SDS_DEG[1] * yaw, size * _SDS_DEG[2] * roll
