"""The last 25 ms of sound: level, energies of two bands, and the newest 10 ms at 4 kHz.

All that is linear in the samples is one matrix: from Python, an FFT and a filter take longer.
"""

import math
from dataclasses import dataclass
from functools import cache

import numpy as np

from lipsync.arrays import Array32
from lipsync.audio_block import BLOCK_S, SAMPLE_RATE_HZ

WINDOW_SAMPLES = 400
BLOCK_SAMPLES = round(BLOCK_S * SAMPLE_RATE_HZ)
#: The level of digital silence; keeps logarithms finite.
SILENCE_DB = -120.0
_LEAST_POWER = 10.0 ** (SILENCE_DB / 10.0)
#: Of HF500 (Bone, Lee and Narayanan, IEEE Trans. Affective Computing 5(2), 2014).
_LOWEST_HZ, _SPLIT_HZ, _HIGHEST_HZ = 80.0, 500.0, 4000.0
#: Bins of a window of 25 ms are 40 Hz apart.
_BIN_HZ = SAMPLE_RATE_HZ / WINDOW_SAMPLES
#: Cosine and sine of each bin.
_N_LOW = 2 * (math.floor(_SPLIT_HZ / _BIN_HZ) - math.ceil(_LOWEST_HZ / _BIN_HZ) + 1)
_N_BANDS = 2 * (math.floor(_HIGHEST_HZ / _BIN_HZ) - math.ceil(_LOWEST_HZ / _BIN_HZ) + 1)
LOW_RATE_HZ = 4000
_LOW_PASS_HZ, _TAPS = 1200.0, 49


@dataclass(slots=True)
class SoundWindow:
    """What samples (400,) at 16 kHz amount to.

    loudness_db: root mean square about the mean, dB re full scale. low_db, high_db: levels of 80 to
    500 Hz and of 500 to 4,000 Hz. newest: the last 10 ms (40,) at 4 kHz, 1.5 ms late by the filter.
    """

    loudness_db: float
    low_db: float
    high_db: float
    newest: Array32


def analyse_window(samples: Array32) -> SoundWindow:
    """What samples (400,) amount to; nothing else is remembered."""
    parts = _transform() @ samples
    low, high = parts[1 : 1 + _N_LOW], parts[1 + _N_LOW : 1 + _N_BANDS]
    mean = float(parts[0])
    return SoundWindow(
        _db(float(samples @ samples) / WINDOW_SAMPLES - mean * mean),
        _db(float(low @ low)),
        _db(float(high @ high)),
        parts[1 + _N_BANDS :],
    )


def _db(power: float) -> float:
    return 10.0 * math.log10(power) if power > _LEAST_POWER else SILENCE_DB


@cache
def _transform() -> Array32:
    """(1 + 198 + 40, 400): the mean, bins of a Fourier transform, a low-pass and decimation."""
    mean = np.full((1, WINDOW_SAMPLES), 1.0 / WINDOW_SAMPLES)
    return np.concatenate((mean, _fourier(), _decimation())).astype(np.float32)


def _fourier() -> Array32:
    """Hann-windowed cosines and sines; by Parseval their squares add up to the band's power."""
    hann = np.hanning(WINDOW_SAMPLES + 1)[:-1]
    hz = np.arange(_LOWEST_HZ, _HIGHEST_HZ + 1.0, _BIN_HZ)
    phases = 2.0 * np.pi / SAMPLE_RATE_HZ * np.outer(hz, np.arange(WINDOW_SAMPLES))
    rows = np.stack((np.cos(phases), np.sin(phases)), axis=1).reshape(-1, WINDOW_SAMPLES)
    scale = math.sqrt(2.0 / (WINDOW_SAMPLES * float(hann @ hann)))
    return np.asarray(scale * rows * hann, np.float32)


def _decimation() -> Array32:
    """(40, 400): a windowed-sinc low-pass (Hamming), applied at every fourth sample."""
    step = SAMPLE_RATE_HZ // LOW_RATE_HZ
    offsets = np.arange(_TAPS) - (_TAPS - 1) / 2
    taps = np.sinc(2.0 * _LOW_PASS_HZ / SAMPLE_RATE_HZ * offsets) * np.hamming(_TAPS)
    rows = np.zeros((BLOCK_SAMPLES // step, WINDOW_SAMPLES), np.float32)
    for index, row in enumerate(rows):
        end = WINDOW_SAMPLES - BLOCK_SAMPLES + step * (index + 1)
        row[end - _TAPS : end] = taps / taps.sum()
    return rows
