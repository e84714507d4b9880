"""How often a text that was not said is taken for one that was, and the other way round."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from lipservo_lab.corpus.transcribed import TranscribedUtterance
from lipsync.recognition.alignment.forced_alignment import AlignmentError, align
from lipsync.recognition.alignment.goodness_of_pronunciation import (
    DOUBTFUL_SCORE,
    LEAST_SCORE,
    goodness_of_pronunciation,
)
from lipsync.recognition.alignment.pronunciation import PronunciationError
from lipsync.recognition.network import NetworkWeights
from lipsync.recognition.speech_file import read_speech

#: The false text is one of so many that are nearest in length: aligners refuse others by that.
_NEAREST = 5
KINDS = ("true", "other", "half_other", "half_missing")


def texts_of(
    utterance: TranscribedUtterance, pool: Sequence[TranscribedUtterance], rng: np.random.Generator
) -> dict[str, str]:
    """By kind: what was said; what another utterance says; half of each; half of what was said."""
    others = [u.text for u in pool if u.text != utterance.text]
    nearest = sorted(others, key=lambda text: abs(len(text) - len(utterance.text)))[:_NEAREST]
    own, other = utterance.text.split(), str(rng.choice(nearest)).split()
    half = max(1, len(own) // 2)
    made = (own, other, [*own[:half], *other[half:]], own[:half])
    return {kind: " ".join(words) for kind, words in zip(KINDS, made, strict=True)}


def score_texts(
    utterances: Sequence[TranscribedUtterance], weights: NetworkWeights, seed: int = 0
) -> Iterator[dict[str, float | None]]:
    """For each utterance the score of each kind of text; None where no alignment was found."""
    rng = np.random.default_rng(seed)
    for utterance in utterances:
        samples = read_speech(utterance.sound)
        scores: dict[str, float | None] = {}
        for kind, text in texts_of(utterance, utterances, rng).items():
            try:
                scores[kind] = goodness_of_pronunciation(
                    samples, align(samples, text).phones, weights
                )
            except (AlignmentError, PronunciationError):
                scores[kind] = None
        yield scores


def text_figures(scores: Sequence[dict[str, float | None]]) -> dict[str, object]:
    """For each kind: how many, how many found no way through, were refused, doubted, passed."""
    figures: dict[str, object] = {"utterances": len(scores)}
    counts: dict[str, Callable[[float], bool]] = {
        "refused": lambda score: score < LEAST_SCORE,
        "doubted": lambda score: LEAST_SCORE <= score < DOUBTFUL_SCORE,
        "passed": lambda score: score >= DOUBTFUL_SCORE,
    }
    for kind in KINDS:
        found = [score for each in scores if (score := each[kind]) is not None]
        figures[f"{kind}_not_aligned"] = len(scores) - len(found)
        for name, counted in counts.items():
            figures[f"{kind}_{name}"] = sum(map(counted, found))
        figures[f"{kind}_score_min_median_max"] = (
            [round(float(x), 2) for x in np.percentile(found, [0, 50, 100])] if found else None
        )
    return figures
