"""What speech wants of the joints now: its targets followed, and faded as they grow old."""

import numpy as np

from firmware_bridge.arrays import Array
from firmware_bridge.gate.limits import StaleLevel, StaleRule
from firmware_bridge.loop.channel import TargetTrack
from firmware_bridge.targets import TargetChannel

_FRESH = StaleLevel.FRESH


class FollowedTargets:
    """Targets in, one wanted angle a joint out; arrays are (n_joints,).

    held_deg: the newest that were followed. was_spoken_to: any, since the start.
    """

    def __init__(self, channel: TargetChannel, n_joints: int, stale: StaleRule) -> None:
        self._channel = channel
        self._stale = stale
        self._track = TargetTrack(n_joints)
        self._fresh_deg: Array | None = None
        self._fresh_s = 0.0
        self._heard_s = 0.0  # display time of the newest target due, or of the start if later
        self.held_deg: Array = np.zeros(n_joints)
        self.was_spoken_to = False

    @property
    def n_rejected(self) -> int:
        """Targets that could not be used."""
        return self._track.n_rejected

    def begin(self, present_deg: Array, time_s: float) -> None:
        """Hold the joints where they stand, until a target comes."""
        self.held_deg = present_deg
        self._heard_s = time_s
        self.was_spoken_to = False

    def take(self, time_s: float) -> bool:
        """Take what came; whether there is a fresh target that may be followed."""
        self._track.push(self._channel.drain())
        target_deg, age_s = self._track.at(time_s)
        if target_deg is None or self._stale.level(age_s) is not _FRESH:
            return False
        self._fresh_deg, self._fresh_s = target_deg, time_s - age_s
        return True

    def follow(self) -> None:
        """From now on the fresh target is what is wanted."""
        assert self._fresh_deg is not None
        self._heard_s = max(self._heard_s, self._fresh_s)
        self.held_deg = self._fresh_deg
        self.was_spoken_to = True

    def silence_s(self, time_s: float) -> float:
        """How old the newest target is that was followed."""
        return max(0.0, time_s - self._heard_s)

    def wanted(self, time_s: float) -> tuple[Array, StaleLevel]:
        """Degrees, and how far speech is given up by now."""
        silence_s = max(0.0, time_s - self._heard_s)
        level = self._stale.level(silence_s)
        if level is _FRESH:
            return self.held_deg, level
        return self.held_deg * self._stale.weight(silence_s), level
