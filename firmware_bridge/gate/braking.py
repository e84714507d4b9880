"""Speeds that can be braked in time, on a grid of steps."""

import numpy as np

from firmware_bridge.arrays import Array


def braking_speed(distance_deg: Array, deceleration_deg_s2: Array, step_s: float) -> Array:
    """The highest speed of the next step from which one stops within `distance_deg`.

    Steps u, u - a, u - 2a, ... (in units of a x step^2) down to rest: with u = m + f, 0 <= f < 1,
    they add up to (m + 1)(m / 2 + f). Solved for u, so the stop is exact on the grid.
    """
    unit = deceleration_deg_s2 * step_s * step_s
    d = np.maximum(distance_deg, 0.0) / unit
    m = np.floor((np.sqrt(1.0 + 8.0 * d) - 1.0) / 2.0)
    return np.asarray((m + d / (m + 1.0) - m / 2.0) * deceleration_deg_s2 * step_s)


class AccelerationLimit:
    """Chooses steps whose change of speed is bounded, and which can stop at goal and range ends.

    Joints with infinite acceleration are left alone.
    """

    def __init__(self, max_acceleration_deg_s2: Array, max_speed_deg_s: Array) -> None:
        self._limited = np.isfinite(max_acceleration_deg_s2)
        self._any = bool(self._limited.any())
        self._acceleration = np.where(self._limited, max_acceleration_deg_s2, 1e12)
        self._top = max_speed_deg_s
        self._velocity = np.zeros(len(max_speed_deg_s))
        self._wanted = np.zeros(len(max_speed_deg_s))

    def rest_at(self, positions_deg: Array) -> None:
        """Start again from standstill."""
        self._velocity = np.zeros(len(self._velocity))
        self._wanted = positions_deg.copy()

    def rest_one(self, index: int, position_deg: float) -> None:
        """One joint starts again from standstill."""
        self._velocity[index] = 0.0
        self._wanted[index] = position_deg

    def step(self, sent: Array, wanted: Array, low: Array, high: Array, step_s: float) -> Array:
        """Where to go from `sent`, in range, when `wanted`, in range, is asked; degrees, (n,)."""
        if not self._any or step_s <= 0.0:
            return wanted
        a, change = self._acceleration, self._acceleration * step_s
        left = wanted - sent
        moving = np.clip((wanted - self._wanted) / step_s, -self._top, self._top)
        with_it = np.where(moving * left > 0.0, np.abs(moving), 0.0)
        reach = np.abs(left) / step_s
        speed = np.minimum(
            reach, braking_speed(np.abs(left), a, step_s) + np.minimum(with_it, reach)
        )
        velocity = np.clip(np.sign(left) * speed, self._velocity - change, self._velocity + change)
        velocity = np.clip(velocity, -self._top, self._top)
        inside = (low <= sent) & (sent <= high)
        up, down = (braking_speed(room, a, step_s) for room in (high - sent, sent - low))
        velocity = np.where(inside, np.clip(velocity, -down, up), velocity)
        self._wanted = wanted
        return np.asarray(np.where(self._limited, sent + velocity * step_s, wanted))

    def sent(self, before: Array, after: Array, step_s: float) -> None:
        """Remember the step that was made in the end."""
        if self._any and step_s > 0.0:
            self._velocity = (after - before) / step_s
