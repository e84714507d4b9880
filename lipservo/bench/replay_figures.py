"""The figures of `lipservo bench replay`: how much faster than sound a file is replayed."""

from pathlib import Path
from statistics import median

import numpy as np
import soundfile

from firmware_bridge.clock import Clock, ManualClock
from lipservo.commands.options import DEFAULT_FACE
from lipservo.street.run_face import Performance
from lipsync.audio.file import FileSource
from lipsync.audio.silence import SilenceAfter

#: Length of the file that is made of a shorter recording.
REPLAYED_S = 20.0


class _TimedClock:
    """A `ManualClock` that is not taken for one: sound is fed block by block, as to a live face."""

    def __init__(self) -> None:
        self._clock = ManualClock()

    def now(self) -> float:
        """Where the clock was left."""
        return self._clock.now()

    def sleep_until(self, time_s: float) -> None:
        """Jump to `time_s`."""
        self._clock.sleep_until(time_s)


def repeated(recording: Path, path: Path, duration_s: float = REPLAYED_S) -> Path:
    """Write the recording over and over until `duration_s`, as WAV at its own rate."""
    samples, rate_hz = soundfile.read(recording, dtype="float32")
    soundfile.write(path, samples[np.arange(round(duration_s * rate_hz)) % len(samples)], rate_hz)
    return path


def replay_figures(recording: Path, n_times: int) -> dict[str, float]:
    """Medians of sound seconds in a second, loading included, and of their ratio.

    Each time the recording is replayed as `lipservo replay` does, and with the sound fed block by
    block, one after the other, so that what else the machine does slows both.
    """
    replayed, by_blocks = [], []
    for _ in range(n_times):
        by_blocks.append(_speed(recording, _TimedClock()))
        replayed.append(_speed(recording, ManualClock()))
    return {
        "replay_speed": median(replayed),
        "replay_speed_block_by_block": median(by_blocks),
        "replay_speed_ratio": median(a / b for a, b in zip(replayed, by_blocks, strict=True)),
    }


def _speed(recording: Path, clock: Clock) -> float:
    performance = Performance(DEFAULT_FACE, None, None, None, live=False, quiet=True)
    with SilenceAfter(FileSource(recording)) as source:
        return performance.play(source, clock).summary.speed
