"""How far the sound of a device is behind the clock: its buffers, and a rate of its own.

A sound card that says 16 kHz delivers some 0.01 % more or less, which is a third of a second in an
hour, and its first samples come a buffer late. Whoever shows sound time by the clock must know.

Sound that stops for a moment and then comes all at once is late only once: when for a second or two
nothing has been as late any more, the lag goes back as quickly as it came.
"""

import math

#: A late arrival is believed at half the speed of time: the mouth slows down rather than stops.
#: When the lag goes back, the mouth is as much faster.
_QUICK = 0.5
#: An early one slowly, so that a device that delivers in large pieces does not shake the mouth;
#: still ten times as fast as cheap clocks drift (50 parts in a million).
_FALL = 0.0005
#: Sound is remembered for one to two of these: more pieces than a device ever takes to be as late
#: as it usually is.
_REMEMBERED_S = 1.0
#: The latest piece of one second and that of the next differ by less: devices deliver on a timer,
#: and are asked every 10 to 30 ms.
_JITTER_S = 0.02


class ArrivalLag:
    """Follows how late sound comes; `lag_s` stays near the latest that it usually is."""

    def __init__(self) -> None:
        self.lag_s = 0.0
        self._observed_s: float | None = None
        # The latest of this second, which began at `_second_s`, and of the one before.
        self._second_s = -math.inf
        self._latest_s = self._latest_before_s = math.inf

    def observe(self, now_s: float, behind_s: float) -> None:
        """At monotonic `now_s` the newest sound is `behind_s` behind the clock, or before it.

        `lag_s` changes by at most half of the time since the last call, whatever comes.
        """
        elapsed_s = 0.0 if self._observed_s is None else max(0.0, now_s - self._observed_s)
        self._observed_s = now_s
        self._remember(now_s, behind_s)
        slowly_s = max(behind_s, self.lag_s - _FALL * elapsed_s)
        usual_s = max(self._latest_s, self._latest_before_s) + _JITTER_S
        wanted_s = min(slowly_s, max(behind_s, usual_s))
        change_s = wanted_s - self.lag_s
        self.lag_s += min(max(change_s, -_QUICK * elapsed_s), _QUICK * elapsed_s)

    def _remember(self, now_s: float, behind_s: float) -> None:
        if now_s < self._second_s + _REMEMBERED_S:
            self._latest_s = max(self._latest_s, behind_s)
            return
        self._second_s = now_s
        self._latest_before_s, self._latest_s = self._latest_s, behind_s
