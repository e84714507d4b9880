"""How much of something is applied, from 0 to 1, as a smooth curve in time."""

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Amount:
    """A cubic from a value and a slope at `start_s` to rest at `goal`; there it stays.

    Hermite's form, so that a new one takes over from any instant of the old one smoothly.
    touched_s: when the last closure was, or will be, complete; as long as it is held, now.
    """

    start_s: float
    duration_s: float
    value: float
    slope_per_s: float
    goal: float
    touched_s: float = -math.inf

    def at(self, time_s: float) -> tuple[float, float]:
        """Value and slope per second at a time not before the start."""
        u = (time_s - self.start_s) / self.duration_s
        if u >= 1.0:
            return self.goal, 0.0
        fall = (1.0 + 2.0 * u) * (1.0 - u) ** 2
        slope = self.slope_per_s * self.duration_s
        value = self.goal + (self.value - self.goal) * fall + slope * u * (1.0 - u) ** 2
        change = 6.0 * u * (u - 1.0) * (self.value - self.goal)
        change += slope * (1.0 - u) * (1.0 - 3.0 * u)
        return value, change / self.duration_s

    def smooth(self, time_s: float) -> float:
        """The value within 0 and 1, with slope 0 at both ends whatever the cubic does there."""
        value = min(1.0, max(0.0, self.at(time_s)[0]))
        return value * value * (3.0 - 2.0 * value)
