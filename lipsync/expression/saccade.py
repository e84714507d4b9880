"""Quick movements of the eyes: how large, which way, how long."""

import math
from bisect import bisect
from itertools import accumulate
from random import Random

from lipsync.expression.bounded import smoothstep
from lipsync.expression.cue import CUE_PERIOD_S

#: Lee, Badler and Badler, "Eyes Alive", SIGGRAPH 2002: magnitude -6.9 ln(P / 15.7) degrees with P
#: uniform up to 15 (percent); duration 25 ms + 2.4 ms a degree; share of each of eight directions,
#: in percent, counter-clockwise from 0 in steps of 45 degrees.
_SCALE_DEG, _MOST_PERCENT, _OFFSET_PERCENT = 6.9, 15.0, 15.7
_SHORTEST_S, _S_PER_DEG = 0.025, 0.0024
_DIRECTIONS = tuple(accumulate((15.54, 6.46, 17.69, 7.44, 16.80, 7.89, 20.38, 7.79)))
_BIN_DEG = 45.0


def drawn_magnitude_deg(random: Random) -> float:
    """0.3 degrees at least; 7.2 on average."""
    percent = _MOST_PERCENT * (1.0 - random.random())
    return -_SCALE_DEG * math.log(percent / _OFFSET_PERCENT)


def drawn_direction_rad(random: Random) -> float:
    """Within one of the eight bins, uniform."""
    nearest = bisect(_DIRECTIONS, random.random() * _DIRECTIONS[-1])
    return math.radians(_BIN_DEG * (nearest + random.random() - 0.5))


def duration_s(magnitude_deg: float) -> float:
    """How long a movement of that size takes."""
    return _SHORTEST_S + _S_PER_DEG * magnitude_deg


class Saccade:
    """One movement of gaze from (yaw, pitch) to (yaw, pitch), degrees, on a straight way."""

    def __init__(self, start_deg: tuple[float, float], aim_deg: tuple[float, float]) -> None:
        self.aim_deg = aim_deg
        self._start_deg = start_deg
        self.magnitude_deg = math.hypot(aim_deg[0] - start_deg[0], aim_deg[1] - start_deg[1])
        self._duration_s = duration_s(self.magnitude_deg)
        self._elapsed_s = 0.0

    def step(self) -> tuple[float, float]:
        """Where gaze is one cue later; at the aim once it is over."""
        self._elapsed_s += CUE_PERIOD_S
        share = smoothstep(self._elapsed_s / self._duration_s)
        if share >= 1.0:
            return self.aim_deg
        yaw_deg, pitch_deg = self._start_deg
        return (
            yaw_deg + share * (self.aim_deg[0] - yaw_deg),
            pitch_deg + share * (self.aim_deg[1] - pitch_deg),
        )

    @property
    def is_over(self) -> bool:
        """Whether gaze has arrived."""
        return self._elapsed_s >= self._duration_s
