"""Hours of speech without a pause: a recogniser must not grow, neither in memory nor in cost."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lipservo_lab.evaluation.recognition.stream_observers import label_frames
from lipsync.audio_block import BLOCK_S, SAMPLE_RATE_HZ, AudioBlock
from lipsync.phonemes import PHONEMES, SILENCE, LiveRecognizer
from lipsync.recognition.streaming import RecognizerStream, StreamStep

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
    labels = label_frames(recognizer, samples)[0].labels
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
    watch = _Watch(n_blocks, resident_mb, progress)
    loop = np.resize(speech, len(speech) // _HOP * _HOP).reshape(-1, _HOP)
    RecognizerStream(recognizer, (watch,)).run(
        AudioBlock(loop[number % len(loop)], number * BLOCK_S) for number in range(n_blocks)
    )
    quarter = max(1, n_blocks // 4)
    return Endurance(
        sound_s=n_blocks * BLOCK_S,
        settled_mb=watch.settled_mb,
        end_mb=resident_mb(),
        first_quarter_s=float(np.median(watch.costs_s[:quarter])),
        last_quarter_s=float(np.median(watch.costs_s[-quarter:])),
        clock_error_s=n_blocks * BLOCK_S - watch.heard_until_s,
    )


class _Watch:
    """Costs of all blocks in memory laid out beforehand; the memory of the process at 10 min."""

    def __init__(
        self,
        n_blocks: int,
        resident_mb: Callable[[], float],
        progress: Callable[[int, int], None],
    ) -> None:
        self.costs_s = np.full(n_blocks, np.inf, np.float32)
        self.heard_until_s = 0.0
        self.settled_mb = resident_mb()
        self._resident_mb = resident_mb
        self._progress = progress
        self._n_seen = 0

    def observe(self, step: StreamStep) -> None:
        number, self._n_seen = self._n_seen, self._n_seen + 1
        self.costs_s[number] = step.cost_s
        if step.updates:
            self.heard_until_s = step.updates[-1].heard_until_s
        if number == round(SETTLED_S / BLOCK_S):
            self.settled_mb = self._resident_mb()
        if number % _BLOCKS_PER_REPORT == 0:
            self._progress(number, len(self.costs_s))
