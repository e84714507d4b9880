"""The face to expect of a line that is heard whole: phonemes around a moment, and the sound there.

Not of the paper. The live expectation knows the phonemes alone; sound tells how they were said:
how wide a vowel was, and when within a phone the mouth turned. Small networks with two hidden
layers of rectifiers, averaged.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array
from lipsync.phonemes import PHONEMES, SILENCE, PhonemeEvent
from lipsync.recognition.features import FRAMES_PER_S

Array32 = NDArray[np.float32]

#: Articulation is read in windows of one recorded frame, so many before and after a moment.
_WINDOW, _N_WINDOWS = 4, 8
#: Sound is read every 20 ms, 160 ms to both sides; more of it tells words apart, not faces.
_SOUND_STEP, _SOUND_REACH = 2, 8
_INDEX_OF = {phoneme: index for index, phoneme in enumerate(PHONEMES)}


def line_inputs(
    events: Sequence[PhonemeEvent], cepstra: Array, times_s: Array, articulation: Array32
) -> Array32:
    """What the networks read at times (n,): (n, n_inputs).

    events: the phones of a line. cepstra: (m, 13), 100 a second. articulation: (40, n_features).
    """
    at = np.rint(times_s * FRAMES_PER_S).astype(np.int64)
    margin = _N_WINDOWS * _WINDOW
    phonemes = _phonemes_on_grid(events, int(at.max(initial=0)) + 1, margin)
    summed = np.cumsum(articulation[phonemes], axis=0, dtype=np.float64)
    summed = np.concatenate([np.zeros((1, summed.shape[1])), summed])
    begin = at[:, None] + margin + np.arange(-_N_WINDOWS, _N_WINDOWS) * _WINDOW
    windows = (summed[begin + _WINDOW] - summed[begin]) / _WINDOW
    names = np.eye(len(PHONEMES))[phonemes[at + margin]]
    offsets = np.arange(-_SOUND_REACH, _SOUND_REACH + 1) * _SOUND_STEP
    sound = cepstra[np.clip(at[:, None] + offsets, 0, len(cepstra) - 1)]
    n = len(at)
    joined = np.concatenate([windows.reshape(n, -1), names, sound.reshape(n, -1)], axis=1)
    return joined.astype(np.float32)


def _phonemes_on_grid(
    events: Sequence[PhonemeEvent], n_frames: int, margin: int
) -> NDArray[np.int64]:
    """The phoneme of each 10 ms from `margin` before the line to `margin` after: numbers."""
    grid = np.full(n_frames + 2 * margin, _INDEX_OF[SILENCE], dtype=np.int64)
    for event in events:
        start = round(event.start_s * FRAMES_PER_S) + margin
        end_s = n_frames / FRAMES_PER_S if event.end_s is None else event.end_s
        grid[start : round(end_s * FRAMES_PER_S) + margin] = _INDEX_OF[event.phoneme]
    return grid


@dataclass(frozen=True, slots=True)
class SoundExpectation:
    """m networks that read `line_inputs`.

    articulation: (40, n_features). mean, spread: (n_inputs,), of the inputs in training. layers:
    weights (m, n_in, n_out) and bias (m, 1, n_out) of each layer, alternating; what the last one
    gives are faces (n, n_components) of the face model.
    """

    articulation: Array32
    mean: Array32
    spread: Array32
    layers: tuple[Array32, ...]

    def faces(self, events: Sequence[PhonemeEvent], cepstra: Array, times_s: Array) -> Array:
        """The expected faces (n, n_components) at times (n,) of a line."""
        inputs = line_inputs(events, cepstra, times_s, self.articulation)
        value = ((inputs - self.mean) / self.spread)[None]
        for weights, bias in zip(self.layers[::2], self.layers[1::2], strict=True):
            value = np.matmul(value, weights) + bias
            if weights is not self.layers[-2]:
                value = np.maximum(value, 0.0)
        return np.asarray(value.mean(axis=0), dtype=np.float64)
