"""Fits the baselines to training sentences, so that comparison is with their best. Offline."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from lipservo_lab.baselines.baselines import Dominance, distances_s, fixed_reference
from lipservo_lab.corpus.utterance import Utterance
from lipsync.arrays import Array
from lipsync.phonemes import PHONEMES, SILENCE, VISEME_OF

Indices = NDArray[np.int64]

#: 200 sentences pin 64 numbers down; more only take longer.
_MOST_SENTENCES = 200
_ITERATIONS = 40
_RATE_BOUNDS, _POWER_BOUNDS = (3.0, 120.0), (0.6, 4.0)
_TINY = 1e-12


def tune_dominance(
    utterances: Sequence[Utterance], coefficients: Sequence[Array], centres: Array
) -> Dominance:
    """Return rate and power per viseme class and direction with the least squared error in speech.

    Quasi-Newton (L-BFGS-B) from the fixed reference, with the exact gradient.

    Parameters
    ----------
    utterances : Sequence[Utterance]
        Labelled.
    coefficients : Sequence[Array]
        (n_frames, n_components) of each.
    centres : Array
        (40, n_components).

    Returns
    -------
    Dominance
        Rates per second, and powers.
    """
    start = fixed_reference()
    step = max(1, len(utterances) // _MOST_SENTENCES)
    sentences = [
        _sentence(u, motion, centres)
        for u, motion in list(zip(utterances, coefficients, strict=True))[::step]
        if any(p.phoneme != SILENCE for p in u.phones)
    ]
    shape = start.rates_per_s.shape
    if not sentences:
        return start

    def cost(x: Array) -> tuple[float, Array]:
        rates, powers = np.exp(x[: len(x) // 2]).reshape(shape), x[len(x) // 2 :].reshape(shape)
        total, slope = 0.0, np.zeros((2, *shape))
        for tau_s, classes, targets, faces in sentences:
            error = _add_sentence(slope, rates, powers, tau_s, classes, targets, faces)
            total += error
        return total, np.concatenate([slope[0].ravel(), slope[1].ravel()])

    n = start.rates_per_s.size
    x0 = np.concatenate([np.log(start.rates_per_s.ravel()), start.powers.ravel()])
    log_bounds = (float(np.log(_RATE_BOUNDS[0])), float(np.log(_RATE_BOUNDS[1])))
    bounds = [log_bounds] * n + [_POWER_BOUNDS] * n
    found = minimize(
        cost, x0, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": _ITERATIONS}
    )
    return Dominance(np.exp(found.x[:n]).reshape(shape), found.x[n:].reshape(shape))


def _sentence(
    utterance: Utterance, motion: Array, centres: Array
) -> tuple[Array, Indices, Array, Array]:
    """Distances (n, k), classes (k,), targets (k, n_components), faces (n, n_components)."""
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

    The gradient is by the logarithms of rates and powers.
    """
    after = (tau_s > 0.0).astype(np.intp)
    each = np.broadcast_to(classes, tau_s.shape)
    rate, power = rates[each, after], powers[each, after]
    reach = np.maximum(rate * np.abs(tau_s), _TINY)
    raised = reach**power
    weights = np.exp(-np.minimum(raised, 600.0))
    total = weights.sum(axis=1, keepdims=True) + _TINY
    error = weights @ targets / total - faces
    # d cost / d weight_k = 2 error . (target_k - face) / total
    pull = 2.0 * (error @ targets.T - (error * (error + faces)).sum(axis=1, keepdims=True)) / total
    by_exponent = -pull * weights
    np.add.at(slope[0], (each, after), by_exponent * power * raised)
    np.add.at(slope[1], (each, after), by_exponent * raised * np.log(reach))
    return float((error**2).sum())
