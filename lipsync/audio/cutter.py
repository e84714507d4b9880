"""Cutting a stream of samples of any lengths into blocks of one length."""

import numpy as np
from numpy.typing import NDArray

from lipsync.audio_block import BLOCK_S, SAMPLE_RATE_HZ, AudioBlock, samples_before

BLOCK_SAMPLES = round(BLOCK_S * SAMPLE_RATE_HZ)


class BlockCutter:
    """Samples in, `AudioBlock`s of 10 ms out; time is the count of samples that went out before."""

    def __init__(self, n_before: int = 0) -> None:
        """n_before: samples of the stream that are left out; the first block starts after them."""
        self._waiting: NDArray[np.float32] = np.zeros(0, dtype=np.float32)
        self._n_out = n_before

    @property
    def held_until_s(self) -> float:
        """Sound time just after the last sample pushed."""
        return (self._n_out + len(self._waiting)) / SAMPLE_RATE_HZ

    def push(self, samples: NDArray[np.float32]) -> None:
        """Add samples (n,) at 16 kHz."""
        self._waiting = np.concatenate((self._waiting, samples))

    def take(self, until_s: float) -> list[AudioBlock]:
        """The whole blocks that end at or before sound time `until_s`."""
        n_wanted = min(samples_before(until_s) - self._n_out, len(self._waiting))
        n_blocks = max(0, int(n_wanted) // BLOCK_SAMPLES)
        return [self._cut(BLOCK_SAMPLES) for _ in range(n_blocks)]

    def take_rest(self, until_s: float) -> list[AudioBlock]:
        """`take`, then the shorter last block of a stream that has ended."""
        blocks = self.take(until_s)
        n_left = len(self._waiting)
        if 0 < n_left < BLOCK_SAMPLES and self._n_out + n_left <= samples_before(until_s):
            blocks.append(self._cut(n_left))
        return blocks

    def _cut(self, n_samples: int) -> AudioBlock:
        block = AudioBlock(self._waiting[:n_samples], self._n_out / SAMPLE_RATE_HZ)
        self._waiting = self._waiting[n_samples:]
        self._n_out += n_samples
        return block
