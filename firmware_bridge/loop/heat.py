"""Amplitude that shrinks to spare hot and hard-working servos."""

from typing import Final

import numpy as np

from firmware_bridge.arrays import Array
from firmware_bridge.health import Feedback, Health

#: Amplitude shrinks over the last degrees below the servo's limit, and with the load's square,
#: which is what heats a winding: full up to half the stall torque (root mean square).
_DERATE_FROM_DEGC: Final = 10.0
_DUTY_S: Final = 60.0
_DUTY_FULL: Final = 0.25
_LEAST_SCALE: Final = 0.3
#: Heat is looked at so often: a winding knows nothing faster, and every tick would pay for it. A
#: little less than the 50 ms meant, so that rounding makes no sixth tick of the fifth.
_HEAT_EVERY_S: Final = 0.049


class HeatDerating:
    """By how much each joint's amplitude shrinks; arrays are (n_servos,)."""

    def __init__(self, n_servos: int) -> None:
        self._duty = np.zeros(n_servos)
        self._duty_at_s: float | None = None
        self._scale = np.ones(n_servos)

    def scale(self, feedback: Feedback, health: Health) -> Array:
        """Of the amplitude, 0.3..1: heat now, and heat to come."""
        if self._duty_at_s is not None:
            if 0.0 <= feedback.time_s - self._duty_at_s < _HEAT_EVERY_S:
                return self._scale
            share = min(1.0, max(0.0, feedback.time_s - self._duty_at_s) / _DUTY_S)
            self._duty += share * (feedback.effort * feedback.effort - self._duty)
        self._duty_at_s = feedback.time_s
        warm = health.room_degc / _DERATE_FROM_DEGC
        worked = 2.0 - self._duty / _DUTY_FULL
        scale = np.minimum(warm, worked)
        np.maximum(scale, _LEAST_SCALE, out=scale)
        self._scale = np.minimum(scale, 1.0, out=scale)
        return self._scale
