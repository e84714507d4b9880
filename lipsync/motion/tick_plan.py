"""Decisions on a time grid of 10 ms: each tick is decided once, from what is known at its time.

The decided values are smooth in time: amounts from 0 to 1, settings that change while the mouth
moves, and how far the mouth is at rest in a pause.
"""

import math
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Generic, TypeVar

from lipsync.phonemes import PHONEMES, SILENCE

#: Speech is published at 100 Hz (architecture.md, Time).
TICK_S = 0.010
#: Number of newest ticks that are kept for times that are asked for again.
_KEPT = 64
#: After a longer leap in time the motion in between was seen by nobody and is not computed.
_LONGEST_LEAP_TICKS = 100
#: A time this share of a tick after a grid point still belongs to it: times are sums of floats.
_ROUNDING_TICKS = 1e-6

Decision = TypeVar("Decision")


def tick_of(time_s: float) -> int:
    """Return the number of the 10 ms tick that contains `time_s`; tick n ends at n * TICK_S."""
    return math.ceil(time_s / TICK_S - _ROUNDING_TICKS)


class TickPlan(Generic[Decision]):
    """The decisions of the newest 64 ticks of 10 ms, each made once and in order, in `at`."""

    def __init__(self, first: Decision) -> None:
        """Create a plan; `first` is the decision that applies until the first tick is decided."""
        self._decisions = deque([first], maxlen=_KEPT)
        self._newest = -1

    @property
    def newest(self) -> Decision:
        """The decision that was made for the newest tick, as `decide` returned it."""
        return self._decisions[-1]

    @property
    def decided_until_s(self) -> float:
        """The time in s until which decisions exist: the end of the newest tick."""
        return self._newest * TICK_S

    def at(self, time_s: float, decide: Callable[[float, Decision], Decision]) -> Decision | None:
        """Return the decision for the tick at `time_s`, None if it is not among the newest 64.

        Ticks not decided yet are decided first, in order and once each, by `decide(end of the tick
        in s, decision of the tick before)`; of more than 100 only the last 100.
        """
        tick = tick_of(time_s)
        # After a leap in time only the last 100 ticks are decided.
        self._newest = max(self._newest, tick - _LONGEST_LEAP_TICKS)
        while self._newest < tick:
            self._decisions.append(decide((self._newest + 1) * TICK_S, self._decisions[-1]))
            self._newest += 1
        n_back = self._newest - tick
        return self._decisions[-1 - n_back] if n_back < len(self._decisions) else None


@dataclass(frozen=True, slots=True)
class Amount:
    """A value over time: a cubic from `value` and `slope_per_s` to `goal`, then constant.

    It starts at `start_s` and reaches `goal` with slope 0 after `duration_s`. Hermite's form, so
    that a new Amount continues from any time of an old one without a jump. touched_s: when the
    last lip closure was, or will be, complete; while it is held, the time of the newest tick.
    """

    start_s: float
    duration_s: float
    value: float
    slope_per_s: float
    goal: float
    touched_s: float = -math.inf

    def at(self, time_s: float) -> tuple[float, float]:
        """Return value and slope per second at `time_s`, which must not be before `start_s`.

        The cubic is Hermite's, from `value` with `slope_per_s` to `goal` with slope 0.
        """
        u = (time_s - self.start_s) / self.duration_s
        if u >= 1.0:
            return self.goal, 0.0
        # The share of the distance from the goal that is left.
        distance_left = (1.0 + 2.0 * u) * (1.0 - u) ** 2
        slope = self.slope_per_s * self.duration_s
        value = self.goal + (self.value - self.goal) * distance_left + slope * u * (1.0 - u) ** 2
        change = 6.0 * u * (u - 1.0) * (self.value - self.goal)
        change += slope * (1.0 - u) * (1.0 - 3.0 * u)
        return value, change / self.duration_s

    def share(self, time_s: float) -> float:
        """Return the value at `time_s`, clipped to 0 to 1."""
        return min(1.0, max(0.0, self.at(time_s)[0]))

    def smooth(self, time_s: float) -> float:
        """Return the value at `time_s`, clipped to 0 to 1 and eased.

        The easing, v to 3 v^2 - 2 v^3, has slope 0 at 0 and at 1.
        """
        value = self.share(time_s)
        return value * value * (3.0 - 2.0 * value)


#: So long a change takes: lips 10 mm apart that are told to close by strength 0 approach at 50 mm/s
#: at most (1.5 times the mean, as of any cubic).
ADJUSTING_S = 0.3


class EasedSetting:
    """A setting between `least` and `most` that eases to each new value within 0.3 s."""

    def __init__(self, value: float, most: float, least: float = 0.0) -> None:
        self._least, self._most = least, most
        self._now = _steady(value)

    @property
    def goal(self) -> float:
        """The value that was set last, whether easing to it is complete or not."""
        return self._now.goal

    def at(self, time_s: float) -> float:
        """Return the value at `time_s`; before the start of the last change, the value at it."""
        value = self._now.at(max(time_s, self._now.start_s))[0]
        # A cubic that turns round on its way may overshoot its limits.
        return min(self._most, max(self._least, value))

    def change(self, start_s: float, value: float) -> None:
        """Start easing to `value` at `start_s`, from the value and slope at that time."""
        now = self._now
        self._now = Amount(start_s, ADJUSTING_S, *now.at(max(start_s, now.start_s)), value)

    def settle(self) -> None:
        """End the easing: `at` then returns the value that was set last for every time."""
        self._now = _steady(self._now.goal)


def values_at(settings: Iterable[EasedSetting], time_s: float) -> list[float]:
    """Return the value of each setting at `time_s`."""
    return [setting.at(time_s) for setting in settings]


def _steady(value: float) -> Amount:
    return Amount(0.0, ADJUSTING_S, value, 0.0, value)


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


def plan_rest(
    now: Amount, phonemes: list[int], times_s: list[float], time_s: float, known_s: float
) -> Amount:
    """Return how far the mouth is at rest from `time_s` on, as an `Amount` from 0 to 1.

    The amount eases to 1 in a pause, and to 0 once the end of the pause is known; `now`, the Amount
    so far, is returned if it has that goal already. phonemes, times_s: what `context_at` returns
    for the end of the tick that begins at `time_s`: five phonemes around it, and six times.
    known_s: seconds beyond that end for which phonemes are known.
    """
    # The present phoneme is a silence that has lasted long, and whose end is not known.
    is_pause = phonemes[2] == _SILENCE and times_s[2] > PAUSE_S and math.isnan(times_s[3])
    if is_pause == (now.goal == 1.0):
        return now
    leaving_s = max(TICK_S, _LEAVING_SHARE * known_s)
    duration_s, goal = (RESTING_S, 1.0) if is_pause else (leaving_s, 0.0)
    return Amount(time_s, duration_s, *now.at(time_s), goal)


def is_reached(rest: Amount, time_s: float) -> bool:
    """Return whether the mouth is fully at rest at `time_s`, and stays so: `rest` is 1, slope 0."""
    return rest.goal == 1.0 and rest.at(time_s) == (1.0, 0.0)
