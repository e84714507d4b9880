"""Joints moved slowly from one pose to another, and a target that fades as it grows old.

Every slow move of a face is a `Ramp`; a `StaleRule` says what replaces a silent speech side.
Pure: time comes in as an argument. What they ask for still goes through the limits of the gate.
"""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

#: Steepest slope of `ease`, at its middle.
EASE_PEAK_SLOPE = 1.5


def ease(progress: float) -> float:
    """From 0 to 1 with rest at both ends: 3 p^2 - 2 p^3, p clipped to [0, 1]."""
    p = min(max(progress, 0.0), 1.0)
    return p * p * (3.0 - 2.0 * p)


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
        """Make a steady ramp on which the joint with the longest way moves at `speed_deg_s`.

        Parameters
        ----------
        start_deg,goal_deg : NDArray[np.float64]
            (n_joints,) degrees.
        start_s : float
            Monotonic seconds.
        speed_deg_s : float
            Degrees a second.

        Returns
        -------
        Ramp
            The ramp; its duration follows from the speed in degrees a second.
        """
        longest_deg = float(np.abs(goal_deg - start_deg).max(initial=0.0))
        return cls(start_deg, goal_deg, start_s, longest_deg / speed_deg_s)

    def at(self, time_s: float) -> NDArray[np.float64]:
        """Return where the joints should be.

        Parameters
        ----------
        time_s : float
            Monotonic seconds.

        Returns
        -------
        NDArray[np.float64]
            (n_joints,) degrees; exactly the goal once it is over.
        """
        share = self._share(time_s)
        if self.eased:
            share = ease(share)
        return np.asarray((1.0 - share) * self.start_deg + share * self.goal_deg)

    def is_over(self, time_s: float) -> bool:
        """Whether the ramp has reached its goal."""
        return time_s - self.start_s >= self.duration_s

    def _share(self, time_s: float) -> float:
        """The part of its time that is over, 0..1; a ramp may last no time at all."""
        if self.is_over(time_s):
            return 1.0
        return max(0.0, (time_s - self.start_s) / self.duration_s)


class StaleLevel(IntEnum):
    """How far the bridge has gone in giving up on a silent speech side."""

    FRESH = 0
    EASING = 1
    NEUTRAL = 2
    LIMP = 3


@dataclass(frozen=True, slots=True)
class StaleRule:
    """What happens when no new target comes: follow and hold, ease to neutral, let go.

    Up to `hold_s` the last target counts in full; from there to `neutral_s` it fades to neutral; at
    `limp_s` torque goes off. The defaults are our choice: 0.1 s is ten missing targets at 100 Hz
    and shorter than most pauses in speech; by 1 s a frozen half-open mouth looks broken; 5 s is
    more than a restart of the speech side takes. Raises ValueError unless the times rise.
    """

    hold_s: float = 0.1
    neutral_s: float = 1.0
    limp_s: float = 5.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.hold_s < self.neutral_s <= self.limp_s:
            raise ValueError(
                f"needs 0 <= hold_s < neutral_s <= limp_s, got {self.hold_s}, {self.neutral_s} "
                f"and {self.limp_s}"
            )

    def level(self, age_s: float) -> StaleLevel:
        """Decide what to do when the newest target is `age_s` old."""
        if age_s <= self.hold_s:
            return StaleLevel.FRESH
        if age_s < self.neutral_s:
            return StaleLevel.EASING
        return StaleLevel.NEUTRAL if age_s < self.limp_s else StaleLevel.LIMP

    def weight(self, age_s: float) -> float:
        """Say how much of the held position remains: 1 while fresh, fading to 0 = neutral."""
        return 1.0 - ease((age_s - self.hold_s) / (self.neutral_s - self.hold_s))
