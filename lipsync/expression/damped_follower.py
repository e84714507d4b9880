"""A critically damped second-order filter: how something with mass follows a target."""

import math

from lipsync.expression.cue import CUE_PERIOD_S

#: Nearer than this, and slower than this a time constant, it has arrived: the last thousandth of a
#: degree would take forever, and a neck that holds must hold. A servo's pulse is 0.088 degrees.
_ARRIVED = 1e-3


class DampedFollower:
    """x'' = w^2 (target - x) - 2 w x', solved exactly over one cue with the target held.

    The error is cut off at 2 `most_per_s` / w, at which the filter's final speed is `most_per_s`:
    it is never exceeded, and nowhere is more acceleration than 4 w `most_per_s`. The filter does
    not overshoot: x stays between the least and the greatest target that it has had.
    """

    def __init__(self, frequency_hz: float, most_per_s: float) -> None:
        """frequency_hz: w / 2 pi; at w the target comes through at half its size."""
        self.value = 0.0
        self._speed_per_s = 0.0
        self._w = 2.0 * math.pi * frequency_hz
        self._decay = math.exp(-self._w * CUE_PERIOD_S)
        self._most_error = 2.0 * most_per_s / self._w

    def follow(self, target: float) -> float:
        """The value one cue later."""
        error, speed_per_s, w = self.value - target, self._speed_per_s, self._w
        if -_ARRIVED < error < _ARRIVED and abs(speed_per_s) < _ARRIVED * w:
            self.value, self._speed_per_s = target, 0.0
            return target
        most = self._most_error
        if error > most:
            error = most
        elif error < -most:
            error = -most
        rise = (speed_per_s + w * error) * CUE_PERIOD_S
        self.value += (error + rise) * self._decay - error
        self._speed_per_s = (speed_per_s - w * rise) * self._decay
        return self.value
