"""The same words by other voices: a shorter or longer vocal tract, shouting, whisper.

Samples are (n,) float32 at 16 kHz and stay as long as they were, so that labels keep their times.
"""

import numpy as np
import soxr
from numpy.lib.stride_tricks import sliding_window_view
from scipy.signal import lfilter

from lipsync.arrays import Array32
from lipsync.audio_block import SAMPLE_RATE_HZ

#: Of the frames that are laid over one another, and how far each may be moved to fit.
_FRAME, _REACH = 480, 120
_N_FFT, _HOP = 512, 128


def warped(samples: Array32, factor: float) -> Array32:
    """All frequencies times `factor`, as of a vocal tract and larynx so much smaller.

    The sound is stretched in time by WSOLA (Verhelst and Roelands, ICASSP 1993) and resampled back
    to its length: 1.15 makes a woman of a man, 1.35 a child.
    """
    stretched = _stretched(samples, factor)
    back = soxr.resample(stretched, SAMPLE_RATE_HZ * factor, SAMPLE_RATE_HZ)
    return _fitted(back, len(samples))


def shouted(rng: np.random.Generator, samples: Array32) -> Array32:
    """More effort: a flatter spectrum, a raised pitch, the loud parts pressed together."""
    raised = warped(samples, rng.uniform(1.03, 1.15))
    pressed = np.tanh(rng.uniform(2.0, 8.0) * raised / max(1e-6, float(np.abs(raised).max())))
    tilted = lfilter([1.0, -rng.uniform(0.2, 0.7)], [1.0], pressed)
    loudest = max(1e-6, float(np.abs(tilted).max()))
    return np.asarray(0.5 * tilted / loudest, np.float32)


def whispered(rng: np.random.Generator, samples: Array32) -> Array32:
    """The spectral envelope, filled with noise in place of the voice, and weaker in the bass."""
    n_frames = max(1, -(-len(samples) // _HOP))
    window = np.hanning(_N_FFT + 1)[:-1]
    padded = np.zeros(n_frames * _HOP + _N_FFT)
    padded[: len(samples)] = samples
    spectra = np.abs(np.fft.rfft(sliding_window_view(padded, _N_FFT)[::_HOP] * window))
    width = 9
    smooth = sliding_window_view(np.pad(spectra, ((0, 0), (width // 2,) * 2), "edge"), width, 1)
    hz = np.fft.rfftfreq(_N_FFT, 1.0 / SAMPLE_RATE_HZ)
    bass = np.minimum(1.0, hz / rng.uniform(500.0, 1200.0))
    noise = np.fft.rfft(rng.standard_normal((len(spectra), _N_FFT)))
    frames = np.fft.irfft(smooth.mean(axis=2) * bass * noise / np.sqrt(_N_FFT)) * window
    total = np.zeros(len(padded))
    for index, frame in enumerate(frames):
        total[index * _HOP : index * _HOP + _N_FFT] += frame
    return (0.3 * total[: len(samples)]).astype(np.float32)


def _stretched(samples: Array32, factor: float) -> Array32:
    """So many times longer at the same pitch: frames, each moved to where it fits the last best."""
    step = _FRAME // 2
    window = np.hanning(_FRAME + 1)[:-1].astype(np.float32)
    n_out = round(len(samples) * factor)
    padded = np.pad(samples, (_REACH, _FRAME + step + 2 * _REACH))
    total = np.zeros(n_out + _FRAME, np.float32)
    goes_on: Array32 = padded[_REACH : _REACH + _FRAME]
    for start in range(0, n_out, step):
        first = round(start / factor)
        near = padded[first : first + _FRAME + 2 * _REACH]
        if len(near) < _FRAME + 2 * _REACH:
            break
        # Every fourth sample is enough to find the place.
        places = sliding_window_view(near, _FRAME)[: 2 * _REACH : 4, ::4]
        best = 4 * int((places @ goes_on[::4]).argmax())
        total[start : start + _FRAME] += window * near[best : best + _FRAME]
        after = first + best + step
        goes_on = padded[after : after + _FRAME]
        if len(goes_on) < _FRAME:
            break
    return total[:n_out]


def _fitted(samples: Array32, n: int) -> Array32:
    fitted = np.zeros(n, np.float32)
    fitted[: min(n, len(samples))] = samples[:n]
    return fitted
