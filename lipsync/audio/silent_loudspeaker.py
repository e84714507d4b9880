"""A loudspeaker without a device: a clock that plays into nothing, for CI and containers."""

import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray


class SilentLoudspeaker:
    """A `lipsync.audio.source.Loudspeaker` whose samples pass by the monotonic clock, unheard.

    Where nothing is written its timeline stands still, as that of a device does. clock: returns
    monotonic seconds.
    """

    #: No sound is resampled for it.
    name, rate_hz = "silent", 16_000
    is_lost, latency_s, n_underruns = False, 0.02, 0

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._written_s = 0.0
        #: At monotonic `_from_s` the timeline was at `_at_s`; it has advanced since.
        self._from_s = self._at_s = 0.0

    def write(self, samples: NDArray[np.float32]) -> None:
        """Write the next samples of the timeline.

        Parameters
        ----------
        samples : NDArray[np.float32]
            (n,) float32 mono at `rate_hz`.
        """
        now_s = self._clock()
        if self._position_at(now_s) >= self._written_s:  # it stood still: all was played
            self._from_s, self._at_s = now_s, self._written_s
        self._written_s += len(samples) / self.rate_hz

    def silence_rest(self) -> float:
        """Return the timeline position, in seconds, from which on it is silent: now."""
        return self._position_at(self._clock())

    def position(self) -> tuple[float, float] | None:
        """Return (monotonic seconds, timeline seconds then); None before anything was written."""
        now_s = self._clock()
        return (now_s, self._position_at(now_s)) if self._written_s else None

    def _position_at(self, now_s: float) -> float:
        """Return the timeline position in s at monotonic `now_s`, at most what was written."""
        return min(self._written_s, self._at_s + now_s - self._from_s)
