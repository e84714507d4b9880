"""Mel-frequency cepstra of a recording, 100 a second, and at the times of its motion.

The cosine transform (SciPy's) of the recogniser's own log-mel bands: Davis and Mermelstein, IEEE
Trans. ASSP 28(4), 1980, equation (1). Normalised per recording, mean and spread of each coefficient
over the frames in which something is heard, so that level, microphone and much of a voice fall out
(Viikki and Laurila, Speech Communication 25, 1998).
"""

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from lipsync.arrays import Array
from lipsync.recognition.features import FRAMES_PER_S, HOP, N_BANDS, WINDOW, log_mel

N_CEPSTRA = 13
_PRE_EMPHASIS = np.float32(0.97)
#: Frames this far below the loudest in their mean log power (30 dB, in natural log units) say
#: nothing about a voice.
_GATE = 30.0 / (10.0 / np.log(10.0))
_SMALLEST_SPREAD = 1e-3


def cepstra(samples: NDArray[np.float32]) -> Array:
    """(n, 13) of samples (m,) at 16 kHz, normalised; that of frame i is centred at i / 100 s."""
    return _normalised(plain_cepstra(samples))


def at_times(found: Array, times_s: Array) -> Array:
    """Cepstra (n, 13), 100 a second, at times (m,): (m, 13); before and after: the ends'."""
    at = np.arange(len(found)) / FRAMES_PER_S
    return np.stack([np.interp(times_s, at, column) for column in found.T], axis=1)


def plain_cepstra(samples: NDArray[np.float32]) -> Array:
    """(n, 13) of samples (m,) at 16 kHz; the window of frame i has its middle at i / 100 s.

    c_k = sqrt(2 / 40) sum_b m_b cos(pi k (b + 1/2) / 40) over the bands m_b, the first one by
    sqrt(1 / 40).
    """
    # A window before the first sample's middle, and one after the last's, are half silence.
    padded = np.concatenate([np.zeros(WINDOW // 2, np.float32), samples])
    padded = np.concatenate([padded, np.zeros(WINDOW + HOP, np.float32)])
    emphasised = padded[1:] - _PRE_EMPHASIS * padded[:-1]
    bands = log_mel(emphasised).astype(np.float64)
    n_frames = len(samples) // HOP + 1
    return np.asarray(dct(bands[:n_frames], norm="ortho", axis=1)[:, :N_CEPSTRA])


def is_heard(found: Array) -> NDArray[np.bool_]:
    """(n,): whether something is heard in a frame of plain cepstra (n, 13)."""
    loudness = found[:, 0] / np.sqrt(N_BANDS)
    return np.asarray(loudness >= loudness.max() - _GATE)


def _normalised(found: Array) -> Array:
    """Each coefficient with mean 0 and spread 1 over the frames in which something is heard."""
    heard = found[is_heard(found)]
    return np.asarray((found - heard.mean(axis=0)) / (heard.std(axis=0) + _SMALLEST_SPREAD))
