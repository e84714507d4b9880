"""A person's hand on single joints while the others go on: slowly there, and slowly back."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from firmware_bridge.arrays import Array
from firmware_bridge.joints import Joint

#: The fastest that a jogged joint goes, there and back. Ours: a hand can be taken away in time.
JOG_DEG_S: Final = 30.0
#: So long after the last word of whoever jogs, everything goes back: nobody may be there any more.
JOG_LASTS_S: Final = 3.0


class Jog:
    """Takes the place of what is wanted of some joints; what comes out passes limiter and rules.

    is_armed: jogging is meant. is_active: `guide` has something to say. Arrays are (n_joints,).
    """

    def __init__(self, joints: Sequence[Joint], period_s: float) -> None:
        """period_s: of a tick, which is the longest step that a joint makes."""
        speeds_deg_s = np.array([joint.max_speed_deg_s for joint in joints])
        self._step_deg = np.minimum(speeds_deg_s, JOG_DEG_S) * period_s
        self._goals_deg = np.full(len(joints), np.nan)  # NaN: not jogged
        self._returns = np.zeros(len(joints), dtype=np.bool_)
        self._until_s = 0.0
        self.is_armed = self.is_active = False

    @property
    def jogged(self) -> list[int]:
        """Which joints are jogged, by index; those on their way back are not."""
        return [int(index) for index in np.flatnonzero(np.isfinite(self._goals_deg))]

    def arm(self, time_s: float) -> None:
        """Jogging is meant from now on, for a while; what is jogged already goes on."""
        self.is_armed = self.is_active = True
        self._until_s = time_s + JOG_LASTS_S

    def move(self, index: int, position_deg: float, time_s: float) -> None:
        """One joint goes there. Only while armed."""
        self._goals_deg[index] = position_deg
        self._returns[index] = False
        self._until_s = time_s + JOG_LASTS_S

    def end(self) -> None:
        """All go back to what is wanted of them, as slowly as they came."""
        self._returns |= np.isfinite(self._goals_deg)
        self._goals_deg[:] = np.nan
        self.is_armed = False
        self.is_active = bool(self._returns.any())

    def return_slowly(self, index: int) -> None:
        """One joint goes from wherever it stands to what is wanted of it, slowly."""
        self._goals_deg[index] = np.nan
        self._returns[index] = self.is_active = True

    def drop(self, index: int) -> None:
        """One joint is moved by nobody any more."""
        self._goals_deg[index] = np.nan
        self._returns[index] = False

    def clear(self) -> None:
        """The face stops, or is let go: whoever moves it now does so from where it is."""
        if self.is_active:
            self._goals_deg[:] = np.nan
            self._returns[:] = False
            self.is_armed = self.is_active = False

    def guide(self, wanted_deg: Array, sent_deg: Array, scale: Array, time_s: float) -> Array:
        """Where the joints should go next, given what is wanted of them and was sent last.

        scale: of the amplitude, to spare servos. Call it in every tick in which it is active.
        """
        if self.is_armed and time_s >= self._until_s:
            self.end()
        is_jogged = np.isfinite(self._goals_deg)
        aim_deg = np.where(is_jogged, self._goals_deg * scale, wanted_deg)
        way_deg = aim_deg - sent_deg
        near_deg = sent_deg + np.clip(way_deg, -self._step_deg, self._step_deg)
        guided_deg = np.where(is_jogged | self._returns, near_deg, wanted_deg)
        self._returns &= np.abs(way_deg) > self._step_deg
        self.is_active = self.is_armed or bool(self._returns.any())
        return guided_deg
