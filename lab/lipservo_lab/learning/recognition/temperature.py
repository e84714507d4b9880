"""Whether posteriors are as sure as they are right, and weights that are less sure.

Guo, Pleiss, Sun and Weinberger, "On calibration of modern neural networks", ICML 2017: the expected
calibration error, and logits divided by a temperature, which changes no decision for the largest
posterior.
"""

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array, Array32
from lipsync.phonemes import PHONEMES, VISEME_CLASSES, VISEME_OF
from lipsync.recognition.network import NetworkWeights

_CLASS_OF: Final = np.array([VISEME_OF[phoneme] for phoneme in PHONEMES])
_MEMBERSHIP: Final = np.eye(len(VISEME_CLASSES), dtype=np.float32)[_CLASS_OF]
_N_BINS: Final = 15


def tempered(weights: NetworkWeights, temperature: float) -> NetworkWeights:
    """Return weights whose logits are divided by a temperature; above 1 they are less sure."""
    temp = np.float32(temperature)
    return replace(weights, output=weights.output / temp, output_bias=weights.output_bias / temp)


def calibration_error(confidence: Array, is_right: Array) -> float:
    """Return the expected calibration error in 15 bins (Guo and others, equation 5).

    Parameters
    ----------
    confidence : Array
        (n,), largest posteriors, 0 to 1.
    is_right : Array
        (n,), 1 where the phone or class of that posterior was spoken, else 0.

    Returns
    -------
    float
        0 to 1.
    """
    bins = np.minimum((confidence * _N_BINS).astype(np.int64), _N_BINS - 1)
    off = np.bincount(bins, confidence - is_right, _N_BINS)
    return float(np.abs(off).sum() / len(confidence))


def reliability(posteriors: Array32, phones: NDArray[np.int64]) -> tuple[float, float]:
    """Return the expected calibration errors of phones and of viseme classes.

    Parameters
    ----------
    posteriors : Array32
        (n, n_phonemes).
    phones : NDArray[np.int64]
        (n,), indices in PHONEMES of the spoken phones.

    Returns
    -------
    tuple[float, float]
        0 to 1 each.
    """
    visemes = posteriors @ _MEMBERSHIP
    compared = (posteriors, phones), (visemes, _CLASS_OF[phones])
    phone_error, viseme_error = (
        calibration_error(each.max(axis=1).astype(np.float64), each.argmax(axis=1) == labels)
        for each, labels in compared
    )
    return phone_error, viseme_error
