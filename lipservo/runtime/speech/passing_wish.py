"""Values that complete a passing request, so that a caller need not give all of them.

Loads nothing: a person who types `lipservo set` stands beside the robot and waits.
"""

from collections.abc import Mapping
from typing import Final

_WHERE: Final = ("look_yaw_deg", "look_pitch_deg")
_MOOD: Final = ("affect_valence", "affect_arousal")


def with_expiry(values: Mapping[str, float], now_s: float) -> dict[str, float]:
    """These settings, and what makes them count: somewhere to look at, when a mood began.

    now_s: monotonic, one clock for all processes of a computer. What is given stays as it is.
    """
    whole = dict(values)
    if any(name in whole for name in _WHERE):
        whole.setdefault("look_weight", 1.0)
    if any(name in whole for name in _MOOD):
        whole.setdefault("affect_at_s", round(now_s, 3))
    return whole
