"""Samples between the live loop, which writes them, and a loudspeaker, which takes them.

One thread writes and one takes. Neither waits for the other and neither needs a lock: each counts
what it has done in a number that only it changes, and all counts are of the timeline's samples,
from the first that was ever written.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

Samples = NDArray[np.float32]

#: Sound may be written so far before it is taken.
RING_S: Final = 2.0
#: A cut fades out within this time, so that nothing clicks.
FADE_S: Final = 0.005


class SampleRing:
    """About two seconds of the timeline. What is not taken in time is lost, the oldest first.

    The timeline stays right whatever happens: where samples were lost it goes on behind them, and
    where none are ready it stands still.
    """

    def __init__(self, rate_hz: int) -> None:
        """rate_hz: samples a second, a multiple of 100."""
        self.rate_hz = rate_hz
        self._ring: Samples = np.zeros((round(RING_S * rate_hz), 1), dtype=np.float32)
        self._n_written = 0  # the writer's
        self._n_taken = 0  # the taker's
        self._n_lost = 0  # likewise
        self._n_underruns = 0  # likewise
        self._is_starved = True  # likewise: nothing is missing before the first sample
        # Half a cosine, 1 to 0.
        turn = np.arange(round(FADE_S * rate_hz), dtype=np.float32) / round(FADE_S * rate_hz)
        self._fade: Samples = (0.5 + 0.5 * np.cos(np.pi * turn)).astype(np.float32)[:, None]

    @property
    def n_written(self) -> int:
        """Samples of the timeline that were written so far."""
        return self._n_written

    @property
    def n_taken(self) -> int:
        """Samples of the timeline that were taken so far, lost ones among them."""
        return self._n_taken

    @property
    def n_lost(self) -> int:
        """Samples that were overwritten before they could be taken."""
        return self._n_lost

    @property
    def n_underruns(self) -> int:
        """How often sound ran out while the loudspeaker asked for more."""
        return self._n_underruns

    def write(self, samples: Samples) -> None:
        """The next samples (n,) of the timeline; n is at most the ring's length."""
        here, from_start = self._parts(self._n_written, self._n_written + len(samples))
        here[:, 0] = samples[: len(here)]
        from_start[:, 0] = samples[len(here) :]
        self._n_written += len(samples)

    def take_into(self, frames: Samples) -> int:
        """Fill frames (n, channels) with the next samples, each on every channel, then with zeros.

        Gives how many samples of the timeline there were.
        """
        size = len(self._ring)
        n_ready = self._n_written - self._n_taken
        if n_ready > size:
            self._n_lost += n_ready - size
            self._n_taken += n_ready - size
            n_ready = size
        n = min(n_ready, len(frames))
        here, from_start = self._parts(self._n_taken, self._n_taken + n)
        frames[: len(here)] = here
        frames[len(here) : n] = from_start
        frames[n:] = 0.0
        if n < len(frames) and not self._is_starved:
            self._n_underruns += 1
        self._is_starved = n < len(frames)
        self._n_taken += n
        return n

    def silence_rest(self, n_untouched: int) -> int:
        """Fade out, then zeros, in place of all that is written and not taken; by the writer.

        n_untouched: the next so many samples stay: the taker may be taking them just now. Gives
        the sample of the timeline from which on it is silent.
        """
        oldest = max(self._n_taken, self._n_written - len(self._ring))
        cut = min(oldest + n_untouched, self._n_written)
        n_fade = min(len(self._fade), self._n_written - cut)
        # Zeros first: were the taker faster than this, it would meet silence.
        for part in self._parts(cut + n_fade, self._n_written):
            part[:] = 0.0
        n_faded = 0
        for part in self._parts(cut, cut + n_fade):
            part *= self._fade[n_faded : n_faded + len(part)]
            n_faded += len(part)
        return max(cut + n_fade, min(self._n_taken, self._n_written))

    def _parts(self, first: int, end: int) -> tuple[Samples, Samples]:
        """Where a stretch of the timeline lies: up to the ring's end, and from its beginning."""
        size = len(self._ring)
        n_here = min(end - first, size - first % size)
        return self._ring[first % size :][:n_here], self._ring[: end - first - n_here]
