"""The input of a recogniser: blocks of any size and rate in, 16 kHz without gaps out."""

import numpy as np
import soxr

from lipsync.arrays import Array32
from lipsync.audio_block import SAMPLE_RATE_HZ, AudioBlock

#: Of a longer gap between blocks only this much is filled with silence, then time jumps to its end.
HEARD_GAP_S = 2.0


class AudioInput:
    """Keeps sound time: what is missing between blocks becomes silence of the same length.

    Sound at another rate is resampled as it comes (soxr), which holds back up to 40 ms of it. NaN
    and infinity become silence, what is beyond full scale is clipped.
    """

    def __init__(self) -> None:
        self._rate_hz: int | None = None
        self._n_fed = 0  # samples at the stream's own rate, gaps among them
        self._resampler: soxr.ResampleStream | None = None

    def take(self, block: AudioBlock) -> tuple[Array32, float, Array32]:
        """Silence that comes first, seconds to jump over after it, and the block's own samples.

        The seconds are a multiple of 10 ms. Raises ValueError for a block that starts before the
        last one's end, and for another rate than the stream began with.
        """
        if self._rate_hz is None:
            self._begin(block.sample_rate_hz)
        rate_hz = block.sample_rate_hz
        if rate_hz != self._rate_hz:
            raise ValueError(
                f"sound at {rate_hz} Hz in a stream at {self._rate_hz} Hz; reset for a new stream"
            )
        n_missing = round(block.start_s * rate_hz) - self._n_fed
        if n_missing < 0:
            raise ValueError(
                f"the block starts at {block.start_s} s, but sound was heard until "
                f"{self._n_fed / rate_hz} s; feed blocks in order, or reset for a new stream"
            )
        n_jumps = max(0, n_missing - round(HEARD_GAP_S * rate_hz)) * 100 // rate_hz
        n_heard = n_missing - n_jumps * rate_hz // 100
        self._n_fed += n_missing + len(block.samples)
        silence = self._at_16_khz(np.zeros(n_heard, np.float32))
        heard = np.where(np.isfinite(block.samples), block.samples, np.float32(0.0))
        samples = np.clip(heard, -1.0, 1.0)
        return silence, n_jumps / 100, self._at_16_khz(samples.astype(np.float32, copy=False))

    def _begin(self, rate_hz: int) -> None:
        self._rate_hz = rate_hz
        if rate_hz != SAMPLE_RATE_HZ:
            self._resampler = soxr.ResampleStream(rate_hz, SAMPLE_RATE_HZ, 1, dtype="float32")

    def _at_16_khz(self, samples: Array32) -> Array32:
        if self._resampler is None or len(samples) == 0:
            return samples
        resampled: Array32 = self._resampler.resample_chunk(samples)
        return np.clip(resampled, -1.0, 1.0)
