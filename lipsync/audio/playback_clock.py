"""Conversion between the monotonic clock and sound time, the position in a sound.

Sound time s is heard at `monotonic_s(s)`, and its face is shown a constant declared delay later,
the sum of what recognition, look-ahead and servos need.

The sound of a device comes later than the clock says, by its lag (`ArrivalLag`): a card that claims
16 kHz delivers some 0.01 % more or less, a third of a second in an hour, and its first samples come
a buffer late. Sound that stops briefly and then comes all at once is late only once: when for a
second or two nothing has been as late any more, the lag goes back as quickly as it came.
"""

import math
from collections import deque
from typing import Protocol

from lipsync.audio.source import AudioSource

#: `lag_s` changes by at most this much a second: for a late arrival the mouth slows down to half
#: its speed rather than stops. When the lag goes back, the mouth is as much faster.
_QUICK = 0.5
#: After an early arrival it falls by so much a second, so that a device that delivers in large
#: pieces does not shake the mouth; still ten times as fast as cheap clocks drift (50 ppm).
_FALL = 0.0005
#: The largest lateness is taken over one to two of these: longer than a device ever takes to be as
#: late as it usually is.
_REMEMBERED_S = 1.0
#: The latest piece of one second and that of the next differ by less: devices deliver on a timer,
#: and are asked every 10 to 30 ms.
_JITTER_S = 0.02


class ArrivalLag:
    """Estimator of how late sound arrives; `lag_s` stays near the largest usual lateness, in s."""

    def __init__(self) -> None:
        self.lag_s = 0.0
        self._observed_s: float | None = None
        # Largest lateness of the second that began at `_second_s`, and of the one before.
        self._second_s = -math.inf
        self._latest_s = self._latest_before_s = math.inf

    def observe(self, now_s: float, behind_s: float) -> None:
        """Update `lag_s`: at monotonic `now_s` the newest sound is `behind_s` behind the clock.

        A negative `behind_s` is ahead of the clock. `lag_s` changes by at most half of the time
        since the last call, whatever comes.
        """
        elapsed_s = 0.0 if self._observed_s is None else max(0.0, now_s - self._observed_s)
        self._observed_s = now_s
        self._note_lateness(now_s, behind_s)
        # The largest lateness, forgotten slowly, but not above the usual one of the last seconds.
        falling_s = max(behind_s, self.lag_s - _FALL * elapsed_s)
        usual_s = max(self._latest_s, self._latest_before_s) + _JITTER_S
        target_s = min(falling_s, max(behind_s, usual_s))
        change_s = target_s - self.lag_s
        self.lag_s += min(max(change_s, -_QUICK * elapsed_s), _QUICK * elapsed_s)

    def _note_lateness(self, now_s: float, behind_s: float) -> None:
        """Add `behind_s` to the largest lateness of the second to which `now_s` belongs."""
        if now_s < self._second_s + _REMEMBERED_S:
            self._latest_s = max(self._latest_s, behind_s)
            return
        self._second_s = now_s
        self._latest_before_s, self._latest_s = self._latest_s, behind_s


#: Arrivals of live sound that are remembered, to tell when what is shown now was captured: more
#: than the longest delay, at 100 a second.
_ARRIVALS = 512
#: Sound time passes at 0 to 1.5 times the speed of time while it follows a device's position: lips
#: stand still where the loudspeaker does, and catch up faster than anybody hears.
_MOST_RISE, _MOST_FALL = 1.0, 0.5
#: Positions are reported with an error of several milliseconds; they are followed this slowly.
_FOLLOWING_S = 0.2


class PlaybackClock(Protocol):
    """A clock that converts between sound time and monotonic time; query it in order of time."""

    def begin(self, zero_s: float) -> None:
        """Start the sound: sound time 0 is heard at monotonic `zero_s`."""

    def sound_s(self, now_s: float) -> float:
        """Return the sound time heard at monotonic `now_s`; negative before the sound begins.

        The sound time never decreases while `now_s` does not.
        """

    def monotonic_s(self, sound_s: float) -> float:
        """Return when sound time `sound_s` is heard, on the monotonic clock, as known now."""

    def arrived(self, now_s: float, until_s: float) -> None:
        """Record that at monotonic `now_s` the sound up to sound time `until_s` had arrived."""

    def captured_s(self, sound_s: float) -> float | None:
        """Return the monotonic time at which sound time `sound_s` was captured; None: not known."""


class SteadyClock:
    """A `PlaybackClock` for a file, silence, or a script: sound is ready whenever it is due."""

    def __init__(self) -> None:
        self._zero_s = 0.0

    def begin(self, zero_s: float) -> None:
        """Start the sound: sound time 0 is heard at monotonic `zero_s`."""
        self._zero_s = zero_s

    def sound_s(self, now_s: float) -> float:
        """Return the sound time that is heard at monotonic `now_s`."""
        return now_s - self._zero_s

    def monotonic_s(self, sound_s: float) -> float:
        """Return when sound time `sound_s` is heard, on the monotonic clock."""
        return self._zero_s + sound_s

    def arrived(self, now_s: float, until_s: float) -> None:
        """Do nothing: sound that no device captures is never late."""

    def captured_s(self, sound_s: float) -> float:
        """Return when `sound_s` is heard: a file's sound counts as captured at that time."""
        return self.monotonic_s(sound_s)


class ArrivalClock:
    """A `PlaybackClock` for a microphone or stream, whose sound arrives late and in pieces."""

    def __init__(self) -> None:
        self._zero_s = 0.0
        self._lag = ArrivalLag()
        # (sound time up to which sound had arrived, monotonic time then less that sound time).
        self._arrivals: deque[tuple[float, float]] = deque(maxlen=_ARRIVALS)

    def begin(self, zero_s: float) -> None:
        """Start the sound: sound time 0 is captured at monotonic `zero_s`, or later."""
        self._zero_s = zero_s

    def sound_s(self, now_s: float) -> float:
        """Return the sound time at monotonic `now_s`, by the smoothed lateness of the sound."""
        return now_s - (self._zero_s + self._lag.lag_s)

    def monotonic_s(self, sound_s: float) -> float:
        """Return when `sound_s` is heard, on the monotonic clock, by the lateness known now."""
        return self._zero_s + self._lag.lag_s + sound_s

    def arrived(self, now_s: float, until_s: float) -> None:
        """Record that at monotonic `now_s` the sound up to sound time `until_s` had arrived."""
        self._lag.observe(now_s, now_s - self._zero_s - until_s)
        if not self._arrivals or self._arrivals[-1][0] < until_s:
            self._arrivals.append((until_s, now_s - until_s))

    def captured_s(self, sound_s: float) -> float | None:
        """Return the monotonic time at which `sound_s` was captured; None: it has not arrived.

        A device is assumed to deliver all that it has captured by then. Query in order of time.
        """
        while self._arrivals and self._arrivals[0][0] < sound_s:
            self._arrivals.popleft()
        return sound_s + self._arrivals[0][1] if self._arrivals else None


class OwnPlaybackClock:
    """A `PlaybackClock` for sound that this program plays on a device that reports its position.

    The recogniser gets the sound `lead_s` before it leaves the loudspeaker; with a lead as long as
    the delay from the recogniser to the mouth, lips and loudspeaker agree.
    """

    def __init__(self, lead_s: float = 0.0) -> None:
        """Create the clock. lead_s: seconds from the recogniser's input to the loudspeaker."""
        #: May be set until `begin`: it depends on the delays of recogniser and servos.
        self.lead_s = lead_s
        self._zero_s = 0.0
        # The lag was `_lag_s` at `_lag_since_s`, and goes to `_target_lag_s` from there.
        self._lag_s = self._target_lag_s = 0.0
        self._lag_since_s = self._queried_s = 0.0

    def begin(self, zero_s: float) -> None:
        """Start the sound: the recogniser gets sound time 0 at monotonic `zero_s`.

        The loudspeaker plays it `lead_s` later.
        """
        self._zero_s = zero_s
        self._lag_s = self._target_lag_s = 0.0
        self._lag_since_s = self._queried_s = zero_s

    def played(self, now_s: float, position_s: float) -> None:
        """Record the report that at monotonic `now_s` sound time `position_s` left the loudspeaker.

        Positions may be in error and reports may come late or out of order: a report counts from
        the last time that was queried, so that no earlier answer changes.
        """
        self._lag_s = self._lag_at(self._queried_s)
        self._lag_since_s = self._queried_s
        self._target_lag_s = now_s - self._zero_s - (position_s + self.lead_s)

    def sound_s(self, now_s: float) -> float:
        """Return the sound time up to which the recogniser gets sound at monotonic `now_s`."""
        self._queried_s = max(self._queried_s, now_s)
        return now_s - (self._zero_s + self._lag_at(now_s))

    def monotonic_s(self, sound_s: float) -> float:
        """Return when, on the monotonic clock, the recogniser gets sound time `sound_s`."""
        return self._zero_s + self._lag_at(self._queried_s) + sound_s

    def arrived(self, now_s: float, until_s: float) -> None:
        """Do nothing: only the reported position of the loudspeaker counts."""

    def captured_s(self, sound_s: float) -> float:
        """Return when the recogniser gets sound time `sound_s`; no device captures this sound."""
        return self.monotonic_s(sound_s)

    def _lag_at(self, now_s: float) -> float:
        """Return how many s the sound is behind the clock at `now_s`, following the last report.

        The lag changes at a bounded rate and, near the reported value, approaches it exponentially.
        """
        elapsed_s = max(0.0, now_s - self._lag_since_s)
        missing_s = self._target_lag_s - self._lag_s
        rate = _MOST_RISE if missing_s > 0.0 else _MOST_FALL
        # Farther than `near_s` from the target the lag moves at the full rate, for `full_s`.
        near_s = rate * _FOLLOWING_S
        full_s = max(0.0, abs(missing_s) - near_s) / rate
        if elapsed_s < full_s:
            return self._lag_s + math.copysign(rate * elapsed_s, missing_s)
        remaining_s = min(abs(missing_s), near_s) * math.exp(-(elapsed_s - full_s) / _FOLLOWING_S)
        return self._target_lag_s - math.copysign(remaining_s, missing_s)


def clock_for(source: AudioSource) -> PlaybackClock:
    """Return a new clock for a source: ArrivalClock for a live device, SteadyClock for others."""
    return ArrivalClock() if source.is_live else SteadyClock()
