"""Simulated servos that follow their goals late: dead time, inertia, top speed, encoder.

Each joint is a critically damped second-order system behind a dead time, with a top speed. Not
simulated: load, heat, a supply that sags, joints that pull at one another.
"""

from dataclasses import dataclass

import numpy as np

from lipsync.arrays import Array

#: Whole lag in slow motion, dead time of bus and servo within it, and top speed: drawn from these.
#: The bar of the benchmark asks for 40 to 90 ms; an XL330-M288-T makes 618 deg/s without load.
LAG_S, DEAD_TIME_S, TOP_SPEED_DEG_S = (0.040, 0.090), (0.010, 0.030), (250.0, 500.0)
#: Of the simulated encoders, which are of no model.
_ENCODER_STEP_DEG = 0.09
#: Steps of the simulation within one sample.
_SUBSTEPS = 10


@dataclass(frozen=True, slots=True)
class SimulatedServos:
    """Simulated servos that follow their goals late; all arrays are (n_servos,).

    lag_s: whole delay behind the goal, dead_time_s included.
    """

    lag_s: Array
    dead_time_s: Array
    top_speed_deg_s: Array

    @classmethod
    def drawn(cls, n_servos: int, seed: int) -> "SimulatedServos":
        """Return n_servos servos with lags, dead times and top speeds drawn from a seed."""
        rng = np.random.default_rng([seed, 1])
        return cls(
            *(rng.uniform(*limits, n_servos) for limits in (LAG_S, DEAD_TIME_S, TOP_SPEED_DEG_S))
        )

    def shafts_deg(self, goals_deg: Array, rate_hz: float) -> Array:
        """Return the angles of the shafts at the instants of goals.

        Before the first goal the servos have rested at that goal for long.

        Parameters
        ----------
        goals_deg : Array
            (n, n_servos) degrees, one row each 1 / rate_hz seconds.
        rate_hz : float
            Goals per second.

        Returns
        -------
        Array
            (n, n_servos) degrees.
        """
        step_s = 1.0 / rate_hz / _SUBSTEPS
        delayed_deg = self._delayed_goals(goals_deg, rate_hz)
        # A critically damped system of frequency omega is 2 / omega late in slow motion.
        omega = 2.0 / (self.lag_s - self.dead_time_s)
        position, speed_deg_s = delayed_deg[0].copy(), np.zeros(len(omega))
        shafts_deg = np.empty_like(goals_deg)
        for n, goal in enumerate(delayed_deg):
            shafts_deg[n] = position
            for _ in range(_SUBSTEPS):
                speed_deg_s += step_s * (omega**2 * (goal - position) - 2.0 * omega * speed_deg_s)
                speed_deg_s = np.clip(speed_deg_s, -self.top_speed_deg_s, self.top_speed_deg_s)
                position = position + step_s * speed_deg_s
        return shafts_deg

    def encoders_deg(self, goals_deg: Array, rate_hz: float) -> Array:
        """Return the angles of the shafts at the instants of goals, rounded to encoder steps.

        Parameters
        ----------
        goals_deg : Array
            (n, n_servos) degrees, one row each 1 / rate_hz seconds.
        rate_hz : float
            Goals per second.

        Returns
        -------
        Array
            (n, n_servos) degrees.
        """
        steps = np.rint(self.shafts_deg(goals_deg, rate_hz) / _ENCODER_STEP_DEG)
        return np.asarray(steps * _ENCODER_STEP_DEG)

    def _delayed_goals(self, goals_deg: Array, rate_hz: float) -> Array:
        """Return goals (n, n_servos), those of each joint later by its dead time.

        Between samples they are interpolated.
        """
        times_s = np.arange(len(goals_deg)) / rate_hz
        columns = [
            np.interp(times_s - dead_s, times_s, column)
            for dead_s, column in zip(self.dead_time_s, goals_deg.T, strict=True)
        ]
        return np.stack(columns, axis=1)
