"""Default values that complete a request to look somewhere or to set a mood.

Imports almost nothing, so that `lipservo set` starts fast beside the robot.
"""

from collections.abc import Mapping
from typing import Final

_WHERE: Final = ("look_yaw_deg", "look_pitch_deg")
_MOOD: Final = ("affect_valence", "affect_arousal")


def with_expiry(values: Mapping[str, float], now_s: float) -> dict[str, float]:
    """Return the settings with `look_weight` 1 added to a look angle, `affect_at_s` to a mood.

    From `affect_at_s` on the mood fades: it is `now_s`, on the monotonic clock that all processes
    of a computer share. Values that were given are kept, these two also.
    """
    completed = dict(values)
    if any(name in completed for name in _WHERE):
        completed.setdefault("look_weight", 1.0)
    if any(name in completed for name in _MOOD):
        completed.setdefault("affect_at_s", round(now_s, 3))
    return completed
