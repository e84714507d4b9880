"""How accurate weights are on recordings whose phonemes are known, by what is settled live."""

from collections.abc import Sequence

import numpy as np

from lipservo_lab.corpus.alignment_cache import PHONEME_INDEX
from lipservo_lab.evaluation.recognition.recognition_scores import Labels, Score
from lipservo_lab.learning.recognition.augmentation import LabelledSamples
from lipsync.phonemes import PhonemeEvent
from lipsync.recognition.batch import settled_phonemes
from lipsync.recognition.features import FRAMES_PER_S
from lipsync.recognition.network import LATENCY_S, NetworkWeights


def settled_score(
    weights: NetworkWeights, recordings: Sequence[LabelledSamples], latency_s: float = LATENCY_S
) -> Score:
    """The score of what the live recogniser settles on, each recording as a new stream.

    As `benchmark.measure`, without its streams and costs: many times quicker.
    """
    score = Score()
    settled = settled_phonemes(weights, [each.samples for each in recordings], latency_s)
    for recording, events in zip(recordings, settled, strict=True):
        score.add(_labels(events, len(recording.labels)), recording.labels)
    return score


def _labels(events: Sequence[PhonemeEvent], n_frames: int) -> Labels:
    """(n_frames,) numbers of the phonemes; the events have no gaps and reach to the end."""
    labels = np.empty(n_frames, np.int64)
    for event in events:
        first = round(event.start_s * FRAMES_PER_S)
        labels[first:] = PHONEME_INDEX[event.phoneme]
    return labels
