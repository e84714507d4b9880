"""A recording over and over, as one long file."""

from pathlib import Path

import numpy as np
import soundfile

#: Length of the file that is made of a shorter recording.
REPLAYED_S = 20.0


def repeated(recording: Path, path: Path, duration_s: float = REPLAYED_S) -> Path:
    """Write a recording again and again, `duration_s` long, as WAV at its rate; return `path`."""
    samples, rate_hz = soundfile.read(recording, dtype="float32")
    soundfile.write(path, samples[np.arange(round(duration_s * rate_hz)) % len(samples)], rate_hz)
    return path
