"""Goals that make the servos be in time: each joint as early as it is late, its backlash added.

Streaming; NumPy only, a few microseconds a frame.
"""

import numpy as np

from calibration.calibration import Following
from calibration.run.backlash import BacklashCompensation
from lipsync.arrays import Array


class LagCompensation:
    """Sends every joint ahead by its lag.

    Poses go in `advance_s` before they are shown; slow joints get theirs at once, quicker ones wait
    here for as long as they are quicker. `feed` is called once each `period_s`.
    """

    def __init__(self, lag_s: Array, period_s: float, *, look_ahead_s: float) -> None:
        """lag_s: (n_servos,). A joint slower than the look-ahead is sent as early as it allows."""
        early_s = np.minimum(np.maximum(lag_s, 0.0), look_ahead_s)
        self.advance_s = float(early_s.max(initial=0.0))
        wait = (self.advance_s - early_s) / period_s
        self._whole = np.floor(wait + 1e-9).astype(np.int64)
        self._part = np.maximum(wait - self._whole, 0.0)
        self._length = int(self._whole.max(initial=0)) + 2
        self._joints = np.arange(len(lag_s))
        self._recent: Array | None = None
        self._newest = 0

    def feed(self, positions_deg: Array) -> Array:
        """The pose (n_servos,) to show `advance_s` from now -> what to ask of the servos now."""
        if self._recent is None:
            self._recent = np.tile(positions_deg, (self._length, 1))
        self._newest = (self._newest + 1) % self._length
        self._recent[self._newest] = positions_deg
        later = self._recent[(self._newest - self._whole) % self._length, self._joints]
        earlier = self._recent[(self._newest - self._whole - 1) % self._length, self._joints]
        return np.asarray(later + self._part * (earlier - later))

    def reset(self) -> None:
        """Forget earlier poses."""
        self._recent = None
        self._newest = 0


class Follower:
    """Lag and backlash together, as a calibration knows them; without a `Following`, no change."""

    def __init__(
        self, following: Following | None, n_servos: int, period_s: float, *, look_ahead_s: float
    ) -> None:
        """look_ahead_s: how much earlier than shown a pose may be asked for."""
        nothing = np.zeros(n_servos)
        lag_s = nothing if following is None else following.lag_s
        backlash_deg = nothing if following is None else following.backlash_deg
        self._lag = LagCompensation(lag_s, period_s, look_ahead_s=look_ahead_s)
        self._backlash = BacklashCompensation(backlash_deg)

    @property
    def advance_s(self) -> float:
        """How much earlier than shown a pose must be fed."""
        return self._lag.advance_s

    def feed(self, positions_deg: Array) -> Array:
        """(n_servos,) -> goals (n_servos,); within the limits they are kept by the last gate."""
        return self._backlash.feed(self._lag.feed(positions_deg))

    def reset(self) -> None:
        """Start anew."""
        self._lag.reset()
        self._backlash.reset()
