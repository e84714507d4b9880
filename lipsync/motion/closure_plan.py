"""When lips must touch: closures planned from the phonemes known now, smooth in time."""

from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import replace

from lipsync.expectation.context import PhonemeTrack
from lipsync.motion.amount import Amount
from lipsync.phonemes import PHONEMES

#: Lips shut, and lower lip at the upper teeth.
BILABIALS = ("P", "B", "M")
LABIODENTALS = ("F", "V")

#: Lips take this long to close, and to part. Chosen on inner splits of the training part
#: (docs/motion.md): shorter is more abrupt, longer closes the vowels around as well.
CLOSING_S = 0.04
PARTING_S = 0.04
#: They touch this long at least, around the moment at which the recordings are tightest.
HOLD_S = 0.02
#: While an M sounds the lips stay shut, from its onset until they must part for what follows.
_HUMMED = PHONEMES.index("M")
_HUM_ENDS_S = 0.03
#: Sums of the same times differ by less.
_ROUNDING_S = 1e-9


OPEN = Amount(0.0, PARTING_S, 0.0, 0.0, 0.0)


def planned(
    now: Amount,
    moments_s: Mapping[int, float],
    track: PhonemeTrack,
    time_s: float,
    known_until_s: float,
) -> Amount:
    """What the amount does from `time_s` on. Once begun, a closure is completed before it ends.

    moments_s: for each phoneme that closes, when after its onset it is tightest.
    """
    if now.goal == 1.0 and time_s < now.start_s + now.duration_s:
        return now
    if _is_due(now.touched_s, moments_s, track, time_s, known_until_s):
        goal, duration_s, touched_s = 1.0, CLOSING_S, time_s + CLOSING_S
    else:
        goal, duration_s, touched_s = 0.0, PARTING_S, now.touched_s
    if goal == now.goal:
        return replace(now, touched_s=time_s) if goal == 1.0 else now
    return Amount(time_s, duration_s, *now.at(time_s), goal, touched_s)


def _is_due(
    touched_s: float,
    moments_s: Mapping[int, float],
    track: PhonemeTrack,
    time_s: float,
    known_until_s: float,
) -> bool:
    """Whether the lips should be closing or closed, by all that is known."""
    # A tightest moment is at most so far from its onset, before or after.
    first = bisect_right(track.starts_s, time_s) - 2
    for i in range(max(0, first), len(track.phonemes)):
        start_s, end_s = track.starts_s[i], track.ends_s[i]
        if start_s > known_until_s + _ROUNDING_S:
            return False
        if track.phonemes[i] in moments_s:
            # In the recordings an M lasts long; a short one is tightest in its middle, not its end.
            moment_s = min(start_s + moments_s[track.phonemes[i]], (start_s + end_s) / 2.0)
            from_s, until_s = moment_s - HOLD_S / 2.0, moment_s + HOLD_S / 2.0
            if track.phonemes[i] == _HUMMED:
                from_s = min(from_s, start_s + HOLD_S)
                until_s = max(until_s, min(end_s, known_until_s) - _HUM_ENDS_S)
            if touched_s < start_s - HOLD_S:
                until_s = max(until_s, end_s)  # told late: close late, as long as it goes on
            begins_s = from_s - CLOSING_S
            if begins_s <= time_s + _ROUNDING_S and time_s < until_s - _ROUNDING_S:
                return True
    return False
