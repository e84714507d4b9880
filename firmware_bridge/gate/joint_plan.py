"""A plan of each joint's next goal, which keeps limits of speed by starting earlier.

The limiter at the bus trusts nothing and knows only its last goal: a joint that should move faster
than it can comes late, and lips that come late do not touch. A planner that knows the next goals
can do better. In this order of priority: no joint leaves its limits; mandatory poses are reached,
the nearest first; everything else is as near as possible to its target, neither early nor late on
average.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.bus import Array
from firmware_bridge.gate.limits import AccelerationLimit, clip

#: Plans stay so far below a joint's limits: clocks of sound and bridge differ by 0.02 %, and a
#: target is a float.
_SHARE_OF_LIMITS = 0.99
#: Nineteen of twenty P B M last so long or longer, so lips that are so late still touch within it.
#: Measured: docs/decisions/closures.md.
_NOTICE_S = 0.04
#: Sweeps of the least-squares approximation in a window that is too fast; each costs 30 us.
_SWEEPS: Final = 3
#: A joint that is so far from its target counts as held back: a lip is off by some tenths of a mm.
_NOTED_DEG = 2.0


@dataclass(frozen=True, slots=True)
class TargetWindow:
    """The targets of all joints for the near future, from the next goal's time on.

    times_s: (k,), seconds from now, ascending from 0; positions_deg: (k, n_joints); must_meet:
    (k,), mandatory poses to which others are adapted, such as lips that touch. urgent_deg:
    (n_joints,), a pose that may become mandatory with no more notice than the window gives; None:
    there is none.
    """

    times_s: Array
    positions_deg: Array
    must_meet: NDArray[np.bool_]
    urgent_deg: Array | None = None


class JointPlan:
    """A streaming planner: `step` plans the next goals, every `period_s`, from a window of targets.

    A rate limit that knows no future lags behind its targets. Where two poses of a window are too
    far apart both are moved by half, so that the motion between them keeps its timing. A pose that
    is mandatory in t seconds bounds where the joint may be now: no farther from that pose than it
    moves in t. A pose that may become urgent bounds it always: a mouth opens no farther than it can
    close in time, which lowers the scale of a motion on a robot that is too slow for the motion,
    and on no other.
    """

    def __init__(
        self, max_speed_deg_s: Array, max_acceleration_deg_s2: Array, period_s: float
    ) -> None:
        """Set the limits, (n_joints,) each, infinity = no limit, and the period between steps."""
        self._speed_deg_s = _SHARE_OF_LIMITS * max_speed_deg_s
        self._acceleration_deg_s2 = _SHARE_OF_LIMITS * max_acceleration_deg_s2
        self._step_deg = self._speed_deg_s * period_s
        self._period_s = period_s
        self._smooth = AccelerationLimit(self._acceleration_deg_s2, self._speed_deg_s)
        self._planned_deg: Array | None = None
        self._n_steps = 0
        self._n_held_back = np.zeros(len(max_speed_deg_s), dtype=np.int64)
        self._is_held_back = self._n_held_back > 0
        # Seconds from rest to full speed: v / a, 0 without a limit of acceleration.
        self._rising_s = self._speed_deg_s / self._acceleration_deg_s2
        self._rises = bool(self._rising_s.any())
        bounded = np.isfinite(max_acceleration_deg_s2)
        self._gentle_deg_s2 = np.where(bounded, self._acceleration_deg_s2, 0.0) / 4.0
        # The range of the joints is kept by the poses of a window, and by the limiter at the bus.
        anywhere_deg = np.full(len(max_speed_deg_s), 1e6)
        self._anywhere_deg = -anywhere_deg, anywhere_deg

    def step(self, window: TargetWindow) -> Array:
        """Plan the next goal of every joint from a window of targets.

        Parameters
        ----------
        window : TargetWindow
            Targets from the next goal's time on.

        Returns
        -------
        Array
            (n_joints,) degrees: goals for the first time of the window.
        """
        poses_deg, step_deg = self._closable(window), self._step_deg
        goal_deg, before_deg = poses_deg[0], self._planned_deg
        if before_deg is None:
            before_deg = goal_deg
            self._smooth.rest_at(goal_deg)
        if len(poses_deg) > 1:
            # Later mandatory poses are kept within reach, the nearest last, since it counts most.
            goal_deg = self._feasible(window.times_s, poses_deg)
            for later in np.flatnonzero(window.must_meet)[::-1].tolist():
                later_deg, reach_deg = poses_deg[later], self._reach(window.times_s[later])
                goal_deg = clip(goal_deg, later_deg - reach_deg, later_deg + reach_deg)
        goal_deg = clip(goal_deg, before_deg - step_deg, before_deg + step_deg)
        smooth_deg = self._smooth.step(before_deg, goal_deg, *self._anywhere_deg, self._period_s)
        self._smooth.sent(before_deg, smooth_deg, self._period_s)
        self._planned_deg = smooth_deg
        self._n_steps += 1
        self._is_held_back = np.abs(window.positions_deg[0] - smooth_deg) > _NOTED_DEG
        self._n_held_back += self._is_held_back
        return smooth_deg

    def stay(self) -> None:
        """Count a step of joints at rest, whose window and goals are those of the step before."""
        self._n_steps += 1
        self._n_held_back += self._is_held_back

    @property
    def held_back_share(self) -> Array:
        """Share of all steps in which each joint was planned more than 2 deg off its target.

        Returns
        -------
        Array
            (n_joints,), 0 to 1.
        """
        return np.asarray(self._n_held_back / max(self._n_steps, 1))

    def _closable(self, window: TargetWindow) -> Array:
        """Return the window's poses, (k, n_joints) degrees, kept near enough to the urgent pose.

        From each pose the urgent one can be reached within the window and the notice that closures
        need, .04 s; mandatory poses stay as they are. Without an urgent pose nothing is limited.
        """
        poses_deg, urgent_deg = window.positions_deg, window.urgent_deg
        if urgent_deg is None:
            return poses_deg
        reach_deg = self._reach(window.times_s[-1] + _NOTICE_S)
        near_deg = clip(poses_deg, urgent_deg - reach_deg, urgent_deg + reach_deg)
        return np.where(window.must_meet[:, None], poses_deg, near_deg)

    def _feasible(self, times_s: Array, poses_deg: Array) -> Array:
        """Return the pose at the first of `times_s` from which top speed can be kept, (n_joints,).

        times_s: (k,) seconds; poses_deg: (k, n_joints). Of all rows of poses that keep top speed,
        those nearest to `poses_deg` by least squares are approached by Dykstra's projections (Boyle
        and Dykstra 1986), from the last pair of poses to the first: each pair's earlier correction
        is undone, and computed anew.
        """
        reach_deg = (times_s[1:] - times_s[:-1])[:, None] * self._speed_deg_s
        if not (np.abs(poses_deg[1:] - poses_deg[:-1]) > reach_deg).any():
            return np.asarray(poses_deg[0])
        found_deg, given_deg = poses_deg.copy(), np.zeros_like(reach_deg)
        for _ in range(_SWEEPS):
            for n in range(len(reach_deg) - 1, -1, -1):
                # What a pair is too far apart, after its former correction is undone, is shared by
                # both poses.
                apart_deg = found_deg[n + 1] - found_deg[n] + given_deg[n]
                excess_deg = apart_deg - clip(apart_deg, -reach_deg[n], reach_deg[n])
                change_deg = 0.5 * (excess_deg - given_deg[n])
                found_deg[n] += change_deg
                found_deg[n + 1] -= change_deg
                given_deg[n] = excess_deg
        return np.asarray(found_deg[0])

    def _reach(self, time_s: float) -> Array:
        """Return how far joints move from rest to rest in `time_s`, (n_joints,) degrees.

        With speed v, acceleration a, and v / a s to reach v: a t^2 / 4 if t < 2 v / a, else
        v (t - v / a).
        """
        if not self._rises:
            return self._speed_deg_s * time_s
        gentle_deg = self._gentle_deg_s2 * time_s * time_s
        swift_deg = self._speed_deg_s * (time_s - self._rising_s)
        return np.where(time_s < 2.0 * self._rising_s, gentle_deg, swift_deg)
