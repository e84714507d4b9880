"""Whole sound files as a recogniser wants them."""

from pathlib import Path

import numpy as np
import soxr
from numpy.typing import NDArray

from lipsync.audio.file import Warn, ignore, read_sound
from lipsync.audio_block import SAMPLE_RATE_HZ


def read_speech(path: Path, warn: Warn = ignore) -> NDArray[np.float32]:
    """The file as samples (n,) float32 mono in [-1, 1] at 16 kHz; else as `read_sound`."""
    samples, rate_hz = read_sound(path, warn)
    if rate_hz == SAMPLE_RATE_HZ:
        return samples
    resampled: NDArray[np.float32] = soxr.resample(samples, rate_hz, SAMPLE_RATE_HZ)
    return np.clip(resampled, -1.0, 1.0)
