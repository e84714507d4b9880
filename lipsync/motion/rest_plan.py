"""When the mouth comes to rest: planned from the phonemes known now, smooth in time."""

import math

from lipsync.motion.amount import Amount
from lipsync.motion.tick_plan import TICK_S
from lipsync.phonemes import PHONEMES, SILENCE

#: Longer than a stop gap inside a word (to 120 ms) with its borders heard 50 ms wrong: a silence
#: that lasts longer is a pause, and in a pause the mouth comes to rest.
PAUSE_S = 0.17
#: So long it takes to come to rest.
RESTING_S = 0.15
#: Rest is left within this share of the look-ahead, 70 ms of 100, so that the mouth is where it
#: should be at the onset. Leaving it 10 ms later was measurably worse (docs/motion.md).
_LEAVING_SHARE = 0.7
_SILENCE = PHONEMES.index(SILENCE)

#: Before the first sound.
AT_REST = Amount(0.0, RESTING_S, 1.0, 0.0, 1.0)


def planned_rest(
    now: Amount, phonemes: list[int], times_s: list[float], time_s: float, known_s: float
) -> Amount:
    """The amount of rest from `time_s` on: to 1 in a pause, to 0 when the end of it is known.

    phonemes, times_s: `context_at` the end of the tick that begins at `time_s`; known_s: how far
    beyond that end phonemes are known.
    """
    is_pause = phonemes[2] == _SILENCE and times_s[2] > PAUSE_S and math.isnan(times_s[3])
    if is_pause == (now.goal == 1.0):
        return now
    leaving_s = max(TICK_S, _LEAVING_SHARE * known_s)
    duration_s, goal = (RESTING_S, 1.0) if is_pause else (leaving_s, 0.0)
    return Amount(time_s, duration_s, *now.at(time_s), goal)


def is_reached(rest: Amount, time_s: float) -> bool:
    """Whether the mouth is fully at rest at a time and stays there."""
    return rest.goal == 1.0 and rest.at(time_s) == (1.0, 0.0)
