"""Backlash of gears and horns, and goals that make up for it."""

import numpy as np

from lipsync.arrays import Array

#: A turn smaller than this is not made up for: goals would chatter by the whole backlash at every
#: rounding. About four steps of the encoder (360/4096 degrees).
_TURN_DEG = 0.35


class BacklashCompensation:
    """Shifts every goal by half the backlash, to the side the joint is moving to.

    feed: one goal after another; the horn then stands at the goal, not half a backlash behind it.
    """

    def __init__(self, backlash_deg: Array) -> None:
        """backlash_deg: (n_servos,), the whole width of the backlash."""
        self._half_deg = backlash_deg / 2
        self._side = np.ones(len(backlash_deg))
        self._furthest_deg: Array | None = None

    def feed(self, positions_deg: Array) -> Array:
        """(n_servos,) where the horns should be -> (n_servos,) goals that bring them there."""
        if self._furthest_deg is None:
            self._furthest_deg = positions_deg.copy()
        beyond = (positions_deg - self._furthest_deg) * self._side
        turned = beyond < -_TURN_DEG
        self._side = np.where(turned, -self._side, self._side)
        self._furthest_deg = np.where(turned | (beyond > 0), positions_deg, self._furthest_deg)
        return np.asarray(positions_deg + self._side * self._half_deg)

    def reset(self) -> None:
        """Forget which way the joints were moving."""
        self._side = np.ones(len(self._half_deg))
        self._furthest_deg = None
