"""Weights where learning knows none: what counts twice is there twice, what counts half is thinned.

Systematic sampling: of n things in their order, round(n w) at even distances.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from lipservo_lab.corpus.utterance import Utterance
from lipservo_lab.learning.expectation.expectation_training import (
    TrainingSet,
    collect_training_set,
    joined,
)
from lipsync.arrays import Array
from lipsync.phonemes import PhonemeEvent


def counted(n: int, weight: float) -> NDArray[np.int64]:
    """Which of n things in their order to take, some of them more than once; 1 takes each once."""
    wanted = max(1, round(n * weight)) if n else 0
    return np.minimum((np.arange(wanted) + 0.5) * n / max(wanted, 1), n - 1).astype(np.int64)


def counted_training_set(
    utterances: Sequence[Utterance],
    coefficients: Sequence[Array],
    heard: Mapping[str, Sequence[PhonemeEvent]] | None = None,
) -> TrainingSet:
    """`collect_training_set` with every context there as often as its speaker counts."""
    sets = []
    for weight in dict.fromkeys(u.weight for u in utterances):
        of_weight = [i for i, u in enumerate(utterances) if u.weight == weight]
        found = collect_training_set(
            [utterances[i] for i in of_weight], [coefficients[i] for i in of_weight], heard
        )
        rows = counted(len(found.faces), weight)
        sets.append(
            TrainingSet(
                found.phonemes[rows],
                found.times_s[rows],
                found.lookahead_s[rows],
                found.faces[rows],
            )
        )
    return joined(sets)


def counted_sentences(utterances: Sequence[Utterance]) -> list[int]:
    """Numbers of the utterances, each there as often as its speaker counts."""
    chosen: list[int] = []
    for weight in dict.fromkeys(u.weight for u in utterances):
        of_weight = [i for i, u in enumerate(utterances) if u.weight == weight]
        chosen += [of_weight[i] for i in counted(len(of_weight), weight)]
    return chosen
