"""Fit the dominance functions to training sentences, for a fair comparison. Offline."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from lipservo_lab.baselines.baselines import Dominance, distances_s, fixed_reference
from lipservo_lab.corpus.utterance import Utterance
from lipsync.arrays import Array
from lipsync.phonemes import PHONEMES, SILENCE, VISEME_OF

Indices = NDArray[np.int64]

#: 200 sentences determine 64 numbers; more only take longer.
_MOST_SENTENCES = 200
_ITERATIONS = 40
_RATE_BOUNDS, _POWER_BOUNDS = (3.0, 120.0), (0.6, 4.0)
_TINY = 1e-12


def tune_dominance(
    utterances: Sequence[Utterance], coefficients: Sequence[Array], centres: Array
) -> Dominance:
    """Return the dominance with the least squared error in speech.

    Rate and power of each viseme class and direction are fitted by a quasi-Newton method (L-BFGS-B)
    from the fixed reference, with the exact gradient.

    Parameters
    ----------
    utterances : Sequence[Utterance]
        Sentences with phone labels.
    coefficients : Sequence[Array]
        Face coefficients (n_frames, n_components) of each.
    centres : Array
        (40, n_components), the face of each phoneme.

    Returns
    -------
    Dominance
        Rates per second, and powers; the fixed reference if no sentence has speech.
    """
    start = fixed_reference()
    step = max(1, len(utterances) // _MOST_SENTENCES)
    sentences = [
        _sentence_arrays(u, motion, centres)
        for u, motion in list(zip(utterances, coefficients, strict=True))[::step]
        if any(p.phoneme != SILENCE for p in u.phones)
    ]
    shape = start.rates_per_s.shape
    if not sentences:
        return start

    def cost(x: Array) -> tuple[float, Array]:
        rates, powers = np.exp(x[: len(x) // 2]).reshape(shape), x[len(x) // 2 :].reshape(shape)
        total, gradient = 0.0, np.zeros((2, *shape))
        for tau_s, classes, targets, faces in sentences:
            error = _add_sentence(gradient, rates, powers, tau_s, classes, targets, faces)
            total += error
        return total, np.concatenate([gradient[0].ravel(), gradient[1].ravel()])

    n = start.rates_per_s.size
    x0 = np.concatenate([np.log(start.rates_per_s.ravel()), start.powers.ravel()])
    log_bounds = (float(np.log(_RATE_BOUNDS[0])), float(np.log(_RATE_BOUNDS[1])))
    bounds = [log_bounds] * n + [_POWER_BOUNDS] * n
    found = minimize(
        cost, x0, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": _ITERATIONS}
    )
    return Dominance(np.exp(found.x[:n]).reshape(shape), found.x[n:].reshape(shape))


def _sentence_arrays(
    utterance: Utterance, motion: Array, centres: Array
) -> tuple[Array, Indices, Array, Array]:
    """Return the frames of speech of a sentence as arrays for `_add_sentence`.

    These are distances in time (n, k), of `distances_s`, classes (k,), targets (k, n_components)
    and faces (n, n_components), for n frames and k phones.
    """
    times_s = np.arange(len(motion)) / utterance.frame_rate_hz
    spoken = np.zeros(len(motion), dtype=bool)
    for p in utterance.phones:
        if p.phoneme != SILENCE and p.end_s is not None:
            spoken |= (times_s >= p.start_s) & (times_s < p.end_s)
    classes = np.array([VISEME_OF[p.phoneme] for p in utterance.phones], dtype=np.int64)
    targets = centres[[PHONEMES.index(p.phoneme) for p in utterance.phones]]
    return distances_s(utterance.phones, times_s[spoken]), classes, targets, motion[spoken]


def _add_sentence(
    slope: Array,
    rates: Array,
    powers: Array,
    tau_s: Array,
    classes: Indices,
    targets: Array,
    faces: Array,
) -> float:
    """Return the squared error of one sentence; add its gradient to `slope`.

    slope: (2, 16, 2), derivatives by the logarithm of each rate, and by each power. The other
    arrays are those of `_sentence_arrays`.
    """
    after = (tau_s > 0.0).astype(np.intp)
    frame_classes = np.broadcast_to(classes, tau_s.shape)
    rate, power = rates[frame_classes, after], powers[frame_classes, after]
    scaled = np.maximum(rate * np.abs(tau_s), _TINY)
    raised = scaled**power
    weights = np.exp(-np.minimum(raised, 600.0))
    total = weights.sum(axis=1, keepdims=True) + _TINY
    error = weights @ targets / total - faces
    # d cost / d weight_k = 2 error . (target_k - face) / total
    pull = 2.0 * (error @ targets.T - (error * (error + faces)).sum(axis=1, keepdims=True)) / total
    by_exponent = -pull * weights
    np.add.at(slope[0], (frame_classes, after), by_exponent * power * raised)
    np.add.at(slope[1], (frame_classes, after), by_exponent * raised * np.log(scaled))
    return float((error**2).sum())
