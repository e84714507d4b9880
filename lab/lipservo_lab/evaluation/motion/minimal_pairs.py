"""How long one phoneme shows in the mouth, from sentences that differ only in that phoneme.

A wrong phoneme that is never corrected looks, from the next phoneme on, like another true sentence.
So the effect of a true phoneme on those after it (coarticulation) is the measure for what a method
may carry over from a wrong one.
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

#: Number of phonemes compared after the one that differs; they are the same in both sentences, as
#: is the one before.
AFTER = 4
#: Instants compared in each phoneme, evenly from its start to its end.
_SAMPLES = 5
#: Samples of the bootstrap.
_N_RESAMPLINGS = 200


@dataclass(frozen=True, slots=True)
class Persistence:
    """How much of a difference remains in the phoneme that differs and in each of those after it.

    shares: (1 + AFTER,), of the first one's; the first is 1. intervals: (1 + AFTER, 2), 95 %, by
    percentile bootstrap over sentences. counted: number of pairs, or of wrong phonemes.
    """

    shares: Array
    intervals: Array
    counted: int


@dataclass(frozen=True, slots=True)
class Pairs:
    """Pairs of stretches of 1 + AFTER phonemes; one phoneme before and AFTER of them are the same.

    sentences: (n, 2), their sentences; phones: (n, 2), the indices of their first phones there;
    differ: (n,), whether the first phoneme differs (a minimal pair) or is the same (a repetition).
    weights: (n,): in each surrounding, any two different phonemes weigh 1 together, however often
    they were spoken, and all repetitions together as much as all minimal pairs.
    """

    sentences: Indices
    phones: Indices
    differ: NDArray[np.bool_]
    weights: Array


def find_pairs(utterances: Sequence[Utterance]) -> Pairs:
    """Find pairs of stretches from different sentences with the same surrounding phonemes.

    Only surroundings with both minimal pairs (the first phoneme differs) and repetitions are kept.
    Stretches have no silence.
    """
    stretches_in: dict[tuple[str, ...], list[tuple[int, int]]] = defaultdict(list)
    for sentence, utterance in enumerate(utterances):
        names = [p.phoneme for p in utterance.phones]
        for i in range(1, len(names) - AFTER):
            stretch = names[i : i + 1 + AFTER]
            if SILENCE not in stretch:
                stretches_in[names[i - 1], *stretch[1:]].append((sentence, i))
    kept_pairs: list[tuple[tuple[int, int], tuple[int, int]]] = []
    differ: list[bool] = []
    weights: list[float] = []
    for same in stretches_in.values():
        # (sentence, index of the first phone) of both; then the set of their first phonemes: one
        # for a repetition, two for a minimal pair.
        pairs = [(a, b) for n, b in enumerate(same) for a in same[:n] if a[0] != b[0]]
        phonemes_of = [
            frozenset(utterances[s].phones[i].phoneme for s, i in pair) for pair in pairs
        ]
        counts = Counter(phonemes_of)
        kinds = [kind for kind in counts if len(kind) == 2]
        n_repetitions = len(pairs) - sum(counts[kind] for kind in kinds)
        if not kinds or not n_repetitions:
            continue
        kept_pairs += pairs
        differ += [len(kind) == 2 for kind in phonemes_of]
        weights += [
            1.0 / counts[kind] if len(kind) == 2 else len(kinds) / n_repetitions
            for kind in phonemes_of
        ]
    both = np.array(kept_pairs, dtype=np.int64).reshape(-1, 2, 2)
    return Pairs(
        both[:, :, 0], both[:, :, 1], np.array(differ, dtype=bool), np.array(weights, dtype=float)
    )


def recorded_persistence(
    model: TrainedModel, utterances: Sequence[Utterance], pairs: Pairs, *, seed: int = 0
) -> Persistence | None:
    """Return how a difference in one phoneme persists in the recordings; None without any pair.

    Repetitions differ as well: their mean square is subtracted.
    """
    motions = []
    for utterance in utterances:
        faces = model.coefficients(utterance.markers_mm)
        frames = _times_s(utterance.phones) * utterance.frame_rate_hz
        numbers = np.arange(len(faces))
        motions.append(np.stack([np.interp(frames, numbers, c) for c in faces.T], axis=2))
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
    """Return how a difference in one phoneme persists in a method's motion; None without pairs."""
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
    """Return how a difference in one phoneme persists in motion; None without any pair.

    motions: (n_phones, _SAMPLES, n_components) of each sentence. seed: of the bootstrap.
    """
    if not len(pairs.differ):
        return None
    # All sentences are joined; rows (n_pairs, 2): first phones of both stretches in the joined
    # array.
    begins = np.cumsum([0, *(len(m) for m in motions[:-1])])
    phones, rows = np.concatenate(motions), begins[pairs.sentences] + pairs.phones
    distance2 = np.stack(
        [_distance2(phones[rows[:, 0] + k], phones[rows[:, 1] + k]) for k in range(1 + AFTER)],
        axis=1,
    )
    rng = np.random.default_rng(seed)
    n = len(motions)
    draws = rng.multinomial(n, np.full(n, 1.0 / n), size=_N_RESAMPLINGS)
    samples = [_shares(distance2, pairs.differ, _weights(draw, pairs)) for draw in draws]
    shares = _shares(distance2, pairs.differ, pairs.weights)
    return persistence_of(shares, samples, int(pairs.differ.sum()))


def persistence_of(shares: Array, samples: Sequence[Array], counted: int) -> Persistence | None:
    """Return shares with their 95 % intervals over bootstrap samples.

    Parameters
    ----------
    shares : Array
        (k,), shares of a difference that remain.
    samples : Sequence[Array]
        Shares (k,) of each bootstrap sample.
    counted : int
        Number of pairs, or of wrong phonemes.

    Returns
    -------
    Persistence | None
        None where nothing moved (NaN).
    """
    finite = np.array([sample for sample in samples if np.isfinite(sample).all()])
    if not len(finite) or not np.isfinite(shares).all():
        return None
    return Persistence(shares, np.percentile(finite, [2.5, 97.5], axis=0).T, counted)


def _distance2(one: Array, other: Array) -> Array:
    """Return squared distances in one phoneme of each pair, means over its instants, (n_pairs,).

    one, other: (n_pairs, _SAMPLES, n_components).
    """
    squares: Array = ((one - other) ** 2).sum(axis=2).mean(axis=1)
    return squares


def _weights(draw: Indices, pairs: Pairs) -> Array:
    """Return weights (n_pairs,) in a bootstrap sample that has sentence i draw[i] times."""
    weights: Array = draw[pairs.sentences].prod(axis=1) * pairs.weights
    return weights


def _shares(distance2: Array, differ: NDArray[np.bool_], weights: Array) -> Array:
    """Return rms distances beyond those of repetitions, divided by that in the first phoneme.

    distance2: (n_pairs, 1 + AFTER); differ, weights: (n_pairs,). The result is (1 + AFTER,); NaN
    without pairs of both kinds, or if the first phoneme differs no more than repetitions do.
    """
    differing, repeated = weights[differ].sum(), weights[~differ].sum()
    if not differing or not repeated:
        return np.full(distance2.shape[1], np.nan)
    beyond = weights[differ] @ distance2[differ] / differing
    beyond = beyond - weights[~differ] @ distance2[~differ] / repeated
    if beyond[0] <= 0.0:
        return np.full(distance2.shape[1], np.nan)
    return np.asarray(np.sqrt(np.maximum(beyond, 0.0) / beyond[0]))
