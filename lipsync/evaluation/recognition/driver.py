"""What a live recogniser says about a recording, and what it costs. For scoring."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lipsync.audio_block import BLOCK_S, SAMPLE_RATE_HZ, AudioBlock
from lipsync.phonemes import PHONEMES, SILENCE, VISEME_OF, LiveRecognizer, PhonemeUpdate
from lipsync.recognition.alignment.alignment_cache import PHONEME_INDEX

Array = NDArray[np.float32]
Labels = NDArray[np.int64]

_HOP = round(BLOCK_S * SAMPLE_RATE_HZ)
_CLASS_OF = np.array([VISEME_OF[phoneme] for phoneme in PHONEMES])
_UNHEARD = -1
#: An estimate of the machine's own load is no figure of ours: only our own processor time counts.
_Clock = Callable[[], int]


@dataclass(frozen=True, slots=True)
class Listening:
    """labels: phoneme numbers (n,) as settled; cost_s: processor time of each 10 ms block (m,).

    n_revisions: how often the viseme of a frame changed after it had first been told.
    """

    labels: Labels
    cost_s: NDArray[np.float64]
    n_revisions: int


def listen(
    recognizer: LiveRecognizer, samples: Array, clock_ns: _Clock = time.thread_time_ns
) -> Listening:
    """Feed samples (n,) at 16 kHz as a live stream would be, and silence until all is settled.

    The blocks are 10 ms long and end where the label of a frame is due: latency_s after the start
    of the frame. So frame t is judged by what was settled when the sound to 10 t ms + latency was
    heard, and nothing later.
    """
    n_frames = len(samples) // _HOP
    n_tail = round((recognizer.latency_s + 0.1) * SAMPLE_RATE_HZ)
    padded = np.concatenate((samples, np.zeros(n_tail, np.float32)))
    first = round(recognizer.latency_s * SAMPLE_RATE_HZ) % _HOP
    belief = _Belief(n_frames)
    costs = []
    edges = [0, *range(first or _HOP, len(padded), _HOP)]
    for start, end in pairwise(edges):
        block = AudioBlock(padded[start:end], start / SAMPLE_RATE_HZ)
        began_ns = clock_ns()
        recognizer.feed(block)
        updates = recognizer.updates()
        costs.append((clock_ns() - began_ns) * 1e-9)
        for update in updates:
            belief.take(update)
    return Listening(belief.labels, np.array(costs), belief.n_revisions)


class _Belief:
    """Phoneme numbers of the frames as last told, frozen where they are final."""

    def __init__(self, n_frames: int) -> None:
        self.labels = np.full(n_frames, PHONEME_INDEX[SILENCE])
        self.n_revisions = 0
        self._told = np.full(n_frames, _UNHEARD)

    def take(self, update: PhonemeUpdate) -> None:
        for event in update.events:
            first = round(max(event.start_s, update.replace_from_s) / BLOCK_S)
            end_s = update.heard_until_s if event.end_s is None else event.end_s
            part = slice(first, round(end_s / BLOCK_S))
            viseme = _CLASS_OF[PHONEME_INDEX[event.phoneme]]
            told = self._told[part]
            self.n_revisions += int(np.count_nonzero((told != _UNHEARD) & (told != viseme)))
            told[:] = viseme
            self.labels[part] = PHONEME_INDEX[event.phoneme]
