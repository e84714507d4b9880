"""How long one phoneme is seen in the mouth: sentences that differ in nothing else nearby.

A wrong phoneme that is not put right looks, from the next one on, like another true sentence. So
what real coarticulation carries over is the measure of what a method may carry over.
"""

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lipservo_lab.corpus.utterance import Utterance
from lipservo_lab.evaluation.motion.methods import Heard, Method
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipsync.arrays import Array
from lipsync.phonemes import SILENCE, PhonemeEvent

Indices = NDArray[np.int64]

#: Phonemes after the one that differs; they are the same on both sides, as is the one before.
AFTER = 4
#: Instants looked at in each phoneme, evenly from its start to its end.
_SAMPLES = 5
#: Of the bootstrap.
_N_RESAMPLINGS = 200


@dataclass(frozen=True, slots=True)
class Persistence:
    """shares: (1 + AFTER,), in the phoneme that differs and in each one after it; the first is 1.

    intervals: (1 + AFTER, 2), 95 % percentile bootstrap over sentences. counted: how many pairs, or
    how many wrong phonemes.
    """

    shares: Array
    intervals: Array
    counted: int


@dataclass(frozen=True, slots=True)
class Pairs:
    """Stretches of 1 + AFTER phonemes that stand in the same surroundings, two by two.

    sentences: (n, 2), their sentences; phones: (n, 2), the numbers of their first phones there;
    differ: (n,), whether the first phoneme differs (a minimal pair) or is the same (a repetition).
    weights: (n,). Two phonemes in one place count as much as any other two in any other place,
    however often they were spoken, and the repetitions of that place as much as they.
    """

    sentences: Indices
    phones: Indices
    differ: NDArray[np.bool_]
    weights: Array


def find_pairs(utterances: Sequence[Utterance]) -> Pairs:
    """Find pairs of stretches from different sentences with the same surrounding phonemes.

    Kept are surroundings that have both minimal pairs (one phoneme differs) and repetitions.
    Stretches hold no silence.
    """
    places: dict[tuple[str, ...], list[tuple[int, int]]] = defaultdict(list)
    for sentence, utterance in enumerate(utterances):
        names = [p.phoneme for p in utterance.phones]
        for i in range(1, len(names) - AFTER):
            stretch = names[i : i + 1 + AFTER]
            if SILENCE not in stretch:
                places[names[i - 1], *stretch[1:]].append((sentence, i))
    ends: list[tuple[tuple[int, int], tuple[int, int]]] = []
    differ: list[bool] = []
    weights: list[float] = []
    for alike in places.values():
        pairs = [(a, b) for n, b in enumerate(alike) for a in alike[:n] if a[0] != b[0]]
        phonemes_of = [
            frozenset(utterances[s].phones[i].phoneme for s, i in pair) for pair in pairs
        ]
        counts = Counter(phonemes_of)
        kinds = [kind for kind in counts if len(kind) == 2]
        n_repetitions = len(pairs) - sum(counts[kind] for kind in kinds)
        if not kinds or not n_repetitions:
            continue
        ends += pairs
        differ += [len(kind) == 2 for kind in phonemes_of]
        weights += [
            1.0 / counts[kind] if len(kind) == 2 else len(kinds) / n_repetitions
            for kind in phonemes_of
        ]
    both = np.array(ends, dtype=np.int64).reshape(-1, 2, 2)
    return Pairs(
        both[:, :, 0], both[:, :, 1], np.array(differ, dtype=bool), np.array(weights, dtype=float)
    )


def recorded_persistence(
    model: TrainedModel, utterances: Sequence[Utterance], pairs: Pairs, *, seed: int = 0
) -> Persistence | None:
    """Return the persistence of a differing phoneme in the recordings.

    Two repetitions differ as well: their mean square is subtracted.
    """
    motions = []
    for utterance in utterances:
        faces = model.coefficients(utterance.markers_mm)
        times_s = _times_s(utterance.phones) * utterance.frame_rate_hz
        numbers = np.arange(len(faces))
        motions.append(np.stack([np.interp(times_s, numbers, c) for c in faces.T], axis=2))
    return _persistence(motions, pairs, seed)


def made_persistence(
    model: TrainedModel,
    utterances: Sequence[Utterance],
    pairs: Pairs,
    method: Method,
    *,
    lookahead_s: float,
    seed: int = 0,
) -> Persistence | None:
    """Return the persistence of a differing phoneme in a method's motion for the same sentences.

    None without any pair.
    """
    used = set(pairs.sentences.ravel().tolist())
    motions = []
    for sentence, utterance in enumerate(utterances):
        times_s = _times_s(utterance.phones)
        faces = np.zeros((times_s.size, model.n_components))
        if sentence in used:
            faces = method.faces(model, Heard(utterance.phones), times_s.ravel(), lookahead_s)
        motions.append(faces.reshape(*times_s.shape, -1))
    return _persistence(motions, pairs, seed)


def _times_s(phones: Sequence[PhonemeEvent]) -> Array:
    """Return evenly spaced times within each phone, (n_phones, _SAMPLES) s."""
    return np.array([np.linspace(p.start_s, p.end_s or p.start_s, _SAMPLES) for p in phones])


def _persistence(motions: Sequence[Array], pairs: Pairs, seed: int) -> Persistence | None:
    """Return the persistence of a differing phoneme in motion; None without any pair.

    motions: (n_phones, _SAMPLES, n_components) of each sentence.
    """
    if not len(pairs.differ):
        return None
    # All sentences end to end; then phones (n_pairs, 2) number into one array.
    begins = np.cumsum([0, *(len(m) for m in motions[:-1])])
    phones, ends = np.concatenate(motions), begins[pairs.sentences] + pairs.phones
    distance2 = np.stack(
        [_distance2(phones[ends[:, 0] + k], phones[ends[:, 1] + k]) for k in range(1 + AFTER)],
        axis=1,
    )
    rng = np.random.default_rng(seed)
    n = len(motions)
    draws = rng.multinomial(n, np.full(n, 1.0 / n), size=_N_RESAMPLINGS)
    samples = [_shares(distance2, pairs.differ, _weights(draw, pairs)) for draw in draws]
    shares = _shares(distance2, pairs.differ, pairs.weights)
    return persistence_of(shares, samples, int(pairs.differ.sum()))


def persistence_of(shares: Array, samples: Sequence[Array], counted: int) -> Persistence | None:
    """Return shares with the intervals of bootstrap samples.

    Parameters
    ----------
    shares : Array
        (k,).
    samples : Sequence[Array]
        (k,) each.
    counted : int
        Pairs.

    Returns
    -------
    Persistence | None
        None where nothing was seen to move (NaN).
    """
    finite = np.array([sample for sample in samples if np.isfinite(sample).all()])
    if not len(finite) or not np.isfinite(shares).all():
        return None
    return Persistence(shares, np.percentile(finite, [2.5, 97.5], axis=0).T, counted)


def _distance2(one: Array, other: Array) -> Array:
    """Return squared distances in one phoneme of each pair, means over its instants, (n_pairs,)."""
    squares: Array = ((one - other) ** 2).sum(axis=2).mean(axis=1)
    return squares


def _weights(draw: Indices, pairs: Pairs) -> Array:
    """Return the pairs' weights in a bootstrap sample that holds each sentence `draw` times."""
    weights: Array = draw[pairs.sentences].prod(axis=1) * pairs.weights
    return weights


def _shares(distance2: Array, differ: NDArray[np.bool_], weights: Array) -> Array:
    """RMS distance beyond that of repetitions, over that in the first phoneme; NaN without any."""
    total, others = weights[differ].sum(), weights[~differ].sum()
    if not total or not others:
        return np.full(distance2.shape[1], np.nan)
    beyond = weights[differ] @ distance2[differ] / total
    beyond = beyond - weights[~differ] @ distance2[~differ] / others
    if beyond[0] <= 0.0:
        return np.full(distance2.shape[1], np.nan)
    return np.asarray(np.sqrt(np.maximum(beyond, 0.0) / beyond[0]))
