"""One stream of speech that the robot is to say: samples come at any rate and pace.

Whoever receives it pushes; the live loop takes blocks of 10 ms. All that costs time, resampling and
cutting, is done by the one who pushes, in its own thread. Between the two stands a deque: no lock,
nobody waits.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import soxr
from numpy.typing import NDArray

from lipsync.audio.cutter import BLOCK_SAMPLES
from lipsync.audio_block import BLOCK_S, SAMPLE_RATE_HZ
from lipsync.phonemes import PhonemeEvent

Samples = NDArray[np.float32]

#: Speech that may wait to be said: five minutes, 72 MB at 48 kHz.
MOST_WAITING_S: Final = 300.0
#: soxr's "LQ" holds back 20 ms, "HQ" 40 (24 and 48 kHz); every one of them is a later first sound.
_RESAMPLING: Final = "LQ"
#: As sound files may have.
LOWEST_RATE_HZ, HIGHEST_RATE_HZ = 4_000, 192_000


class PlayoutFullError(ValueError):
    """More speech waits than is kept; nothing of the samples was taken."""


@dataclass(frozen=True, slots=True)
class PlayoutBlock:
    """10 ms of a stream: for the recogniser (160,) at 16 kHz, for the loudspeaker at its rate.

    n_samples: of the stream, at its own rate, up to and with this block.
    """

    heard: Samples
    played: Samples
    n_samples: int


class PlayoutStream:
    """Samples in, blocks out. One thread pushes, one takes.

    name: the stream's id. phonemes: what is said in it, where that is known beforehand, in seconds
    from its first sample; empty: a recogniser finds out. played_elsewhere: who sends it plays it,
    and our loudspeaker is silent.
    """

    def __init__(
        self,
        name: str,
        sample_rate_hz: int,
        output_rate_hz: int,
        phonemes: Sequence[PhonemeEvent] = (),
        *,
        played_elsewhere: bool = False,
    ) -> None:
        """output_rate_hz: the loudspeaker's, a multiple of 100. Raises ValueError for a rate."""
        if not LOWEST_RATE_HZ <= sample_rate_hz <= HIGHEST_RATE_HZ:
            allowed = f"{LOWEST_RATE_HZ} to {HIGHEST_RATE_HZ} Hz are possible"
            raise ValueError(f"sample rate {sample_rate_hz} Hz: {allowed}")
        if output_rate_hz % 100:
            raise ValueError(f"output rate {output_rate_hz} Hz is no multiple of 100")
        self.name = name
        self.sample_rate_hz = sample_rate_hz
        self.phonemes = tuple(phonemes)
        self.played_elsewhere = played_elsewhere
        self._heard = _Resampled(sample_rate_hz, SAMPLE_RATE_HZ)
        self._played = _Resampled(sample_rate_hz, output_rate_hz)
        self._blocks: deque[PlayoutBlock] = deque()
        self._marks: deque[tuple[int, str]] = deque()
        self._n_received = 0
        self._n_cut = 0
        self._ended = False
        self._dropped = False

    @property
    def n_received(self) -> int:
        """Samples that were pushed so far, at the stream's own rate."""
        return self._n_received

    @property
    def waiting_s(self) -> float:
        """Speech that waits to be said, in whole blocks."""
        return len(self._blocks) * BLOCK_S

    @property
    def ended(self) -> bool:
        """Nothing is pushed any more."""
        return self._ended

    @property
    def is_dropped(self) -> bool:
        """Nobody will hear what was not taken."""
        return self._dropped

    @property
    def is_over(self) -> bool:
        """Ended, and every block was taken or dropped."""
        return self._ended and (self._dropped or not self._blocks)

    def push(self, samples: Samples) -> None:
        """Add samples (n,) float32 in [-1, 1].

        Of a stream that was dropped nothing is taken any more. Raises PlayoutFullError, and
        ValueError once the stream has ended.
        """
        if self._dropped:
            return
        if self._ended:
            raise ValueError(f"stream {self.name!r} has ended")
        if self.waiting_s + len(samples) / self.sample_rate_hz > MOST_WAITING_S:
            waiting = f"{MOST_WAITING_S:g} s of speech wait already"
            raise PlayoutFullError(f"stream {self.name!r}: {waiting}")
        self._n_received += len(samples)
        self._heard.push(samples)
        self._played.push(samples)
        self._cut()

    def mark(self, name: str) -> None:
        """Tell when all that was pushed until now has been heard."""
        self._marks.append((self._n_received, name))

    def end(self) -> None:
        """No more comes; the last block is filled up with silence."""
        if self._ended:
            return
        both = (self._heard, BLOCK_SAMPLES), (self._played, self._played.rate_hz // 100)
        for resampled, _ in both:
            resampled.push(np.zeros(0, dtype=np.float32), last=True)
        # The two may differ by a sample, which may be the first of a block.
        n_blocks = max(-(-resampled.n_ready // length) for resampled, length in both)
        for resampled, length in both:
            resampled.fill(n_blocks * length)
        self._cut()
        self._ended = True

    def take(self) -> PlayoutBlock | None:
        """The next block; None: none has come yet, or the stream is over."""
        return self._blocks.popleft() if self._blocks and not self._dropped else None

    def drop(self) -> None:
        """The taker's: forget all that was not taken, whatever is being pushed meanwhile."""
        self._dropped = self._ended = True
        self._blocks.clear()

    def marks_until(self, n_samples: int) -> list[str]:
        """The marks, each once, that lie at or before this many samples."""
        reached = []
        while self._marks and self._marks[0][0] <= n_samples:
            reached.append(self._marks.popleft()[1])
        return reached

    def _cut(self) -> None:
        """As many blocks as both resamplers have given."""
        n_played = self._played.rate_hz // 100
        while self._heard.n_ready >= BLOCK_SAMPLES and self._played.n_ready >= n_played:
            self._n_cut += 1
            n_samples = min(self._n_received, round(self._n_cut * BLOCK_S * self.sample_rate_hz))
            block = PlayoutBlock(
                self._heard.take(BLOCK_SAMPLES), self._played.take(n_played), n_samples
            )
            self._blocks.append(block)


class _Resampled:
    """Samples of one rate, taken at another."""

    def __init__(self, from_hz: int, to_hz: int) -> None:
        self.rate_hz = to_hz
        self._resampler = (
            None
            if from_hz == to_hz
            else soxr.ResampleStream(from_hz, to_hz, 1, dtype="float32", quality=_RESAMPLING)
        )
        self._ready: Samples = np.zeros(0, dtype=np.float32)

    @property
    def n_ready(self) -> int:
        return len(self._ready)

    def push(self, samples: Samples, *, last: bool = False) -> None:
        if self._resampler is not None:
            samples = self._resampler.resample_chunk(samples, last=last)
        self._ready = np.concatenate((self._ready, samples))

    def fill(self, n_samples: int) -> None:
        """Silence up to this many."""
        silence = np.zeros(n_samples - len(self._ready), dtype=np.float32)
        self._ready = np.concatenate((self._ready, silence))

    def take(self, n_samples: int) -> Samples:
        taken, self._ready = self._ready[:n_samples], self._ready[n_samples:]
        return taken
