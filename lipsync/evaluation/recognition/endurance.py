"""Hours of speech without a pause: a recogniser must not grow, neither in memory nor in cost."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lipsync.audio_block import BLOCK_S, SAMPLE_RATE_HZ, AudioBlock
from lipsync.evaluation.recognition.driver import listen
from lipsync.phonemes import PHONEMES, SILENCE, LiveRecognizer

Samples = NDArray[np.float32]

_HOP = round(BLOCK_S * SAMPLE_RATE_HZ)
#: By then all buffers are full and every path was taken.
SETTLED_S = 600.0
_BLOCKS_PER_REPORT = 6_000


@dataclass(frozen=True, slots=True)
class Endurance:
    """What a long stream cost; costs are processor time of a 10 ms block, medians of a quarter."""

    sound_s: float
    settled_mb: float
    end_mb: float
    first_quarter_s: float
    last_quarter_s: float
    clock_error_s: float

    def as_dict(self) -> dict[str, float]:
        """For JSON. `clock_error_ms`: sound fed less sound reported on, at the end."""
        return {
            "endurance_hours": self.sound_s / 3600.0,
            "endurance_rss_mb_after_10_min": self.settled_mb,
            "endurance_rss_mb_end": self.end_mb,
            "endurance_block_ms_first_quarter": 1e3 * self.first_quarter_s,
            "endurance_block_ms_last_quarter": 1e3 * self.last_quarter_s,
            "endurance_cost_ratio": self.last_quarter_s / self.first_quarter_s,
            "endurance_clock_error_ms": 1e3 * self.clock_error_s,
        }


def without_pauses(recognizer: LiveRecognizer, samples: Samples) -> Samples:
    """The samples (n,) without the 10 ms frames that the recogniser calls silent."""
    recognizer.reset()
    labels = listen(recognizer, samples).labels
    frames = samples[: len(labels) * _HOP].reshape(-1, _HOP)
    spoken: Samples = frames[labels != PHONEMES.index(SILENCE)].ravel()
    return spoken


def endure(
    recognizer: LiveRecognizer,
    speech: Samples,
    duration_s: float,
    resident_mb: Callable[[], float],
    progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> Endurance:
    """Play speech (n,) over and over for `duration_s` of sound time, as fast as it goes.

    resident_mb: the memory of the process now. What is kept for the figures is laid out before the
    stream begins.
    """
    recognizer.reset()
    n_blocks = round(duration_s / BLOCK_S)
    costs_s = np.full(n_blocks, np.inf, np.float32)
    loop = np.resize(speech, len(speech) // _HOP * _HOP).reshape(-1, _HOP)
    settled_mb, heard_until_s = resident_mb(), 0.0
    for number in range(n_blocks):
        block = AudioBlock(loop[number % len(loop)], number * BLOCK_S)
        began_ns = time.thread_time_ns()
        recognizer.feed(block)
        updates = recognizer.updates()
        costs_s[number] = (time.thread_time_ns() - began_ns) * 1e-9
        heard_until_s = updates[-1].heard_until_s if updates else heard_until_s
        if number == round(SETTLED_S / BLOCK_S):
            settled_mb = resident_mb()
        if number % _BLOCKS_PER_REPORT == 0:
            progress(number, n_blocks)
    quarter = max(1, n_blocks // 4)
    return Endurance(
        sound_s=n_blocks * BLOCK_S,
        settled_mb=settled_mb,
        end_mb=resident_mb(),
        first_quarter_s=float(np.median(costs_s[:quarter])),
        last_quarter_s=float(np.median(costs_s[-quarter:])),
        clock_error_s=n_blocks * BLOCK_S - heard_until_s,
    )
