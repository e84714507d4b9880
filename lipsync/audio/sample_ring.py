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
        size = len(self._ring)
        first = self._n_written % size
        n_here = min(len(samples), size - first)
        self._ring[first : first + n_here, 0] = samples[:n_here]
        self._ring[: len(samples) - n_here, 0] = samples[n_here:]
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
        first = self._n_taken % size
        n_here = min(n, size - first)
        frames[:n_here] = self._ring[first : first + n_here]
        frames[n_here:n] = self._ring[: n - n_here]
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
        cut = min(self._n_taken + n_untouched, self._n_written)
        n_left = self._n_written - cut
        n_fade = min(len(self._fade), n_left)
        size = len(self._ring)
        # Zeros first: were the taker faster than this, it would meet silence.
        where = np.arange(cut, self._n_written) % size
        self._ring[where[n_fade:]] = 0.0
        self._ring[where[:n_fade]] *= self._fade[:n_fade]
        return max(cut + n_fade, min(self._n_taken, self._n_written))
