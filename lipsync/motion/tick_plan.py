"""Decisions on a grid of 10 ms: each tick once, from what is known at its own time."""

import math
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

#: Speech is published at 100 Hz (architecture.md, Time).
TICK_S = 0.010
#: Ticks kept for times that are asked for again.
_KEPT = 64
#: After a longer leap in time the motion in between was seen by nobody and is not computed.
_LONGEST_LEAP_TICKS = 100
#: A time this share of a tick after a grid point still belongs to it: times are sums of floats.
_ROUNDING_TICKS = 1e-6

Decision = TypeVar("Decision")


def tick_of(time_s: float) -> int:
    """The number of the tick that a time lies in; tick n ends at n TICK_S."""
    return math.ceil(time_s / TICK_S - _ROUNDING_TICKS)


class TickPlan(Generic[Decision]):
    """What was decided for the newest ticks, in bounded memory."""

    def __init__(self, first: Decision) -> None:
        """first: holds until the first tick that is asked for."""
        self._kept = deque([first], maxlen=_KEPT)
        self._newest = -1

    @property
    def newest(self) -> Decision:
        """The last decision."""
        return self._kept[-1]

    @property
    def decided_until_s(self) -> float:
        """Until when the motion is decided: the end of the newest tick."""
        return self._newest * TICK_S

    def at(self, time_s: float, decide: Callable[[float, Decision], Decision]) -> Decision | None:
        """The decision for the tick of a time; None for one that is no longer kept.

        decide: from the end of a tick, s, and the decision before it. Called once a tick, in order.
        """
        number = tick_of(time_s)
        self._newest = max(self._newest, number - _LONGEST_LEAP_TICKS)
        while self._newest < number:
            self._kept.append(decide((self._newest + 1) * TICK_S, self._kept[-1]))
            self._newest += 1
        back = self._newest - number
        return self._kept[-1 - back] if back < len(self._kept) else None
