"""How far the sound of a device is behind the clock: its buffers, and a rate of its own.

A sound card that says 16 kHz delivers some 0.01 % more or less, which is a third of a second in an
hour, and its first samples come a buffer late. Whoever shows sound time by the clock must know.
"""

#: A late arrival is believed at half the speed of time: the mouth slows down rather than stops.
_RISE = 0.5
#: An early one slowly, so that a device that delivers in large pieces does not shake the mouth;
#: still ten times as fast as cheap clocks drift (50 parts in a million).
_FALL = 0.0005


class ArrivalLag:
    """Follows how late sound comes; `lag_s` stays near the latest that it usually is."""

    def __init__(self) -> None:
        self.lag_s = 0.0
        self._observed_s: float | None = None

    def observe(self, now_s: float, behind_s: float) -> None:
        """At monotonic `now_s` the newest sound is `behind_s` behind the clock, or before it."""
        elapsed_s = 0.0 if self._observed_s is None else max(0.0, now_s - self._observed_s)
        self._observed_s = now_s
        change_s = behind_s - self.lag_s
        self.lag_s += min(max(change_s, -_FALL * elapsed_s), _RISE * elapsed_s)
