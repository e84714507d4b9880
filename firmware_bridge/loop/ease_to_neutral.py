"""Easing to neutral at the end: in half a second, or as long as the joints' speeds need."""

from collections.abc import Sequence

import numpy as np

from firmware_bridge.arrays import Array
from firmware_bridge.gate.limits import EASE_PEAK_SLOPE
from firmware_bridge.gate.ramp import Ramp
from firmware_bridge.joints import Joint

#: Time to neutral when the joints can make it: a person waits for it.
_EASE_S = 0.5
#: The joints go limp after this long wherever they are: whoever pressed Ctrl-C is waiting.
_LONGEST_S = 2.0


class EaseToNeutral:
    """From where the joints stand, (n_joints,) degrees, to neutral, with rest at both ends."""

    def __init__(self, joints: Sequence[Joint], start_deg: Array, start_s: float) -> None:
        speeds_deg_s = np.array([joint.max_speed_deg_s for joint in joints])
        needed_s = float((EASE_PEAK_SLOPE * np.abs(start_deg) / speeds_deg_s).max(initial=0.0))
        neutral_deg = np.zeros_like(start_deg)
        self._ramp = Ramp(start_deg, neutral_deg, start_s, max(_EASE_S, needed_s), eased=True)
        #: Whether every joint was told to be at neutral, which is where it goes limp.
        self.arrived = False

    def at(self, time_s: float) -> Array:
        """Where the joints should be, (n_joints,) degrees."""
        return self._ramp.at(time_s)

    def over(self, sent_deg: Array, time_s: float) -> bool:
        """Whether the joints were sent to neutral, or have been on their way for too long."""
        self.arrived = self._ramp.is_over(time_s) and not sent_deg.any()
        return self.arrived or time_s - self._ramp.start_s >= _LONGEST_S
