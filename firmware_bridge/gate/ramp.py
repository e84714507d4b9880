"""Joints moved from one pose to another in a set time: every slow move of a face is one of these.

Pure: time comes in as an argument. What it asks for still goes through the limits of the gate.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.gate.limits import ease


@dataclass(frozen=True, slots=True)
class Ramp:
    """From start_deg to goal_deg, (n_joints,) each; it begins at start_s and lasts duration_s.

    eased: with rest at both ends (`ease`), whose greatest speed is `EASE_PEAK_SLOPE` times the
    steady speed that it has otherwise. All joints arrive together.
    """

    start_deg: NDArray[np.float64]
    goal_deg: NDArray[np.float64]
    start_s: float
    duration_s: float
    eased: bool = False

    @classmethod
    def at_speed(
        cls,
        start_deg: NDArray[np.float64],
        goal_deg: NDArray[np.float64],
        start_s: float,
        speed_deg_s: float,
    ) -> "Ramp":
        """Steady, so that the joint with the longest way moves at `speed_deg_s`."""
        longest_deg = float(np.abs(goal_deg - start_deg).max(initial=0.0))
        return cls(start_deg, goal_deg, start_s, longest_deg / speed_deg_s)

    def at(self, time_s: float) -> NDArray[np.float64]:
        """Where the joints should be, (n_joints,) degrees; exactly the goal once it is over."""
        share = self._share(time_s)
        if self.eased:
            share = ease(share)
        return np.asarray((1.0 - share) * self.start_deg + share * self.goal_deg)

    def is_over(self, time_s: float) -> bool:
        """Whether the goal is asked for."""
        return time_s - self.start_s >= self.duration_s

    def _share(self, time_s: float) -> float:
        """The part of its time that is over, 0..1; a ramp may last no time at all."""
        if self.is_over(time_s):
            return 1.0
        return max(0.0, (time_s - self.start_s) / self.duration_s)
