"""Joints moved slowly from one pose to another, and a target that fades as it grows old.

Every slow move of a face is a `Ramp`; a `StaleRule` decides what replaces missing targets. Pure:
time comes in as an argument. The poses of a ramp still pass the limits of the gate.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.bus import Array, all_set
from firmware_bridge.joints import Joint

#: Steepest slope of `ease`, at its middle.
EASE_PEAK_SLOPE = 1.5


def ease(progress: float) -> float:
    """Return 3 p^2 - 2 p^3, p = progress clipped to [0, 1]: from 0 to 1 with rest at both ends."""
    p = min(max(progress, 0.0), 1.0)
    return p * p * (3.0 - 2.0 * p)


@dataclass(frozen=True, slots=True)
class Ramp:
    """A move from start_deg to goal_deg, (n_joints,) each, from start_s on for duration_s.

    eased: with rest at both ends (`ease`); the greatest speed is then `EASE_PEAK_SLOPE` times that
    of a steady ramp. All joints arrive together.
    """

    start_deg: Array
    goal_deg: Array
    start_s: float
    duration_s: float
    eased: bool = False

    @classmethod
    def at_speed(
        cls, start_deg: Array, goal_deg: Array, start_s: float, speed_deg_s: float
    ) -> "Ramp":
        """Return a steady ramp on which the joint that moves farthest has `speed_deg_s`.

        Parameters
        ----------
        start_deg,goal_deg : Array
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

    def at(self, time_s: float) -> Array:
        """Return the pose of the ramp at a time.

        Parameters
        ----------
        time_s : float
            Monotonic seconds.

        Returns
        -------
        Array
            (n_joints,) degrees; exactly the goal once the ramp is over.
        """
        share = 1.0 if self.is_over(time_s) else max(0.0, (time_s - self.start_s) / self.duration_s)
        if self.eased:
            share = ease(share)
        return np.asarray((1.0 - share) * self.start_deg + share * self.goal_deg)

    def is_over(self, time_s: float) -> bool:
        """Return whether the ramp has reached its goal at `time_s`."""
        return time_s - self.start_s >= self.duration_s


#: Time to neutral when the joints can make it: a person waits for it.
_EASE_S: Final = 0.5
#: The joints go limp after this long wherever they are, since a person waits for the stop.
_LONGEST_S: Final = 2.0
#: Rounding in the limiter may leave a joint so far from neutral; no servo resolves it.
_SAME_DEG: Final = 1e-6


class EaseToNeutral:
    """A move from the joints' positions, (n_joints,) degrees, to neutral; at rest at both ends."""

    def __init__(self, joints: Sequence[Joint], start_deg: Array, start_s: float) -> None:
        """Begin at `start_deg`, (n_joints,) degrees, at monotonic `start_s`.

        It takes .5 s, or so long that no joint exceeds its top speed.
        """
        speeds_deg_s = np.array([joint.max_speed_deg_s for joint in joints])
        needed_s = float((EASE_PEAK_SLOPE * np.abs(start_deg) / speeds_deg_s).max(initial=0.0))
        neutral_deg = np.zeros_like(start_deg)
        self._ramp = Ramp(start_deg, neutral_deg, start_s, max(_EASE_S, needed_s), eased=True)
        #: Whether every joint was at neutral when the move was over.
        self.arrived = False

    def at(self, time_s: float) -> Array:
        """Return the pose of the move at a time.

        Parameters
        ----------
        time_s : float
            Monotonic seconds.

        Returns
        -------
        Array
            (n_joints,) degrees.
        """
        return self._ramp.at(time_s)

    def over(self, sent_deg: Array, driven: NDArray[np.bool_], time_s: float) -> bool:
        """Return whether the move is over: driven joints are sent to neutral, or 2 s have passed.

        Stores in `arrived` whether all joints are at neutral.

        Parameters
        ----------
        sent_deg : Array
            (n_joints,) degrees: goals sent last; of a limp joint, where it is.
        driven : NDArray[np.bool_]
            (n_joints,): False for limp joints, which are not waited for.
        time_s : float
            Monotonic seconds.

        Returns
        -------
        bool
            False while the move goes on.
        """
        is_there, is_over = np.abs(sent_deg) <= _SAME_DEG, self._ramp.is_over(time_s)
        self.arrived = is_over and all_set(is_there)
        is_done = is_over and all_set(is_there | ~driven)
        return is_done or time_s - self._ramp.start_s >= _LONGEST_S


class StaleLevel(IntEnum):
    """What the bridge does when no targets come: follow, ease to neutral, stay there, go limp."""

    FRESH = 0
    EASING = 1
    NEUTRAL = 2
    LIMP = 3


@dataclass(frozen=True, slots=True)
class StaleRule:
    """What happens when no new target arrives: follow and hold, ease to neutral, torque off.

    Up to `hold_s` the last target counts in full; from there to `neutral_s` it fades to neutral; at
    `limp_s` torque goes off. The defaults are our choice: 0.1 s is ten missing targets at 100 Hz
    and shorter than most pauses in speech; by 1 s a frozen half-open mouth looks broken; 5 s is
    more than a restart of the speech process takes. Raises ValueError unless the times rise.
    """

    hold_s: float = 0.1
    neutral_s: float = 1.0
    limp_s: float = 5.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.hold_s < self.neutral_s <= self.limp_s:
            raise ValueError(
                f"a ramp needs 0 <= hold_s < neutral_s <= limp_s, got {self.hold_s}, "
                f"{self.neutral_s} and {self.limp_s}"
            )

    def level(self, age_s: float) -> StaleLevel:
        """Return what the bridge does when the newest target is `age_s` old."""
        if age_s <= self.hold_s:
            return StaleLevel.FRESH
        if age_s < self.neutral_s:
            return StaleLevel.EASING
        return StaleLevel.NEUTRAL if age_s < self.limp_s else StaleLevel.LIMP

    def weight(self, age_s: float) -> float:
        """Return the share of the last target kept at `age_s`: 1 while fresh, then down to 0."""
        return 1.0 - ease((age_s - self.hold_s) / (self.neutral_s - self.hold_s))
