"""The phonemes of a clip and their times: aligned with its text, or else recognised."""

from dataclasses import dataclass, replace
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.errors import UserError
from lipsync.phonemes import SILENCE, PhonemeEvent
from lipsync.recognition.alignment import (
    DOUBTFUL_SCORE,
    LEAST_SCORE,
    AlignmentError,
    align,
    goodness_of_pronunciation,
)
from lipsync.recognition.batch import settled_phonemes
from lipsync.recognition.network import NetworkWeights, load_shipped_weights
from lipsync.textgrid import Interval

#: Clips need no live answer: the recogniser may use the longest delay that it was trained with.
_LATENCY_S = 0.145
_LEAST_SPEECH_S = 0.3


class LabelingError(UserError):
    """The phonemes of a clip cannot be found; one line: why, what to do."""


@dataclass(frozen=True, slots=True)
class ClipLabels:
    """Phones without gaps, and words, with times in the clip's sound.

    source: whether they are from the text or recognised. score: of the text (`align`).
    """

    phones: tuple[PhonemeEvent, ...]
    words: tuple[Interval, ...]
    source: Literal["text", "recognised"]
    score: float | None = None

    @property
    def is_doubtful(self) -> bool:
        """Whether text and sound may differ in some words."""
        return self.score is not None and self.score < DOUBTFUL_SCORE

    def within(self, from_s: float, duration_s: float) -> "ClipLabels":
        """Return the labels of a part of the clip, with times from the beginning of the part."""
        phones = tuple(
            replace(phone, start_s=start_s, end_s=end_s)
            for phone in self.phones
            for start_s, end_s in [_clipped_times(phone.start_s, phone.end_s, from_s, duration_s)]
            if end_s > start_s
        )
        words = tuple(
            (word, start_s, end_s)
            for word, word_start_s, word_end_s in self.words
            for start_s, end_s in [_clipped_times(word_start_s, word_end_s, from_s, duration_s)]
            if end_s > start_s
        )
        return replace(self, phones=phones, words=words)

    def tiers(self) -> dict[str, tuple[Interval, ...]]:
        """Return the tiers for `write_tiers`."""
        phones = tuple((p.phoneme, p.start_s, p.end_s or p.start_s) for p in self.phones)
        return {"words": self.words, "phones": phones}


def label_clip(samples: NDArray[np.float32], text: str | None) -> ClipLabels:
    """Label samples (n,) at 16 kHz by their text, or by the recogniser if text is None.

    Raises AlignmentError if the text is not spoken in the sound, and LabelingError if there is too
    little speech.
    """
    if text is None:
        recognized = next(iter(settled_phonemes(_weights(), [samples], _LATENCY_S)))
        end_s = len(samples) / SAMPLE_RATE_HZ
        labels = ClipLabels(recognized, (), "recognised").within(0.0, end_s)
    else:
        aligned = align(samples, text)
        score = goodness_of_pronunciation(samples, aligned.phones, _weights())
        if score < LEAST_SCORE:
            raise AlignmentError(
                f"the text is not spoken: it scores {score:.1f}, spoken texts score above "
                f"{LEAST_SCORE}; correct the text"
            )
        labels = ClipLabels(aligned.phones, aligned.words, "text", round(score, 2))
    spoken_s = sum(
        (p.end_s or p.start_s) - p.start_s for p in labels.phones if p.phoneme != SILENCE
    )
    if spoken_s < _LEAST_SPEECH_S:
        raise LabelingError(f"only {spoken_s:.1f} s of speech found; speak louder or longer")
    return labels


def _clipped_times(
    start_s: float, end_s: float | None, from_s: float, duration_s: float
) -> tuple[float, float]:
    """Return start and end relative to `from_s`, limited to 0 to `duration_s`, s."""
    last_s = start_s if end_s is None else end_s
    return max(0.0, start_s - from_s), min(duration_s, last_s - from_s)


@cache
def _weights() -> NetworkWeights:
    return load_shipped_weights()
