"""Which frames count: speech, and in the new-words test the new words alone."""

import numpy as np
from numpy.typing import NDArray

from lipservo_lab.corpus.utterance import Utterance
from lipsync.phonemes import SILENCE


def speech_frames(utterance: Utterance, words: frozenset[str] | None = None) -> NDArray[np.bool_]:
    """(n_frames,): inside a phone that is not silence, and inside one of `words` if given."""
    times_s = np.arange(len(utterance.markers_mm)) / utterance.frame_rate_hz
    spoken = np.zeros(len(times_s), dtype=bool)
    for phone in utterance.phones:
        if phone.phoneme != SILENCE and phone.end_s is not None:
            spoken |= (times_s >= phone.start_s) & (times_s < phone.end_s)
    if words is not None:
        inside = np.zeros(len(times_s), dtype=bool)
        for word in utterance.words:
            if word.text in words:
                inside |= (times_s >= word.start_s) & (times_s < word.end_s)
        spoken &= inside
    return spoken
