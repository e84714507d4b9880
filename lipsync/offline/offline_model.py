"""The model that lines are rendered with: states and units, faces expected from sound, the voice.

Mel-frequency cepstra are the cosine transform (SciPy's) of the recogniser's own log-mel bands, 100
a second: Davis and Mermelstein, IEEE Trans. ASSP 28(4), 1980, equation (1). They are normalised per
recording, mean and spread of each coefficient over the audible frames, so that level, microphone
and much of a voice fall out (Viikki and Laurila, Speech Communication 25, 1998).

The long-term mean of the cepstra distinguishes voices and microphones, whatever the words (Furui,
IEEE Trans. ASSP 29(2), 1981). Normalising removes it, but the cepstra of another voice still differ
from the learned ones: for another voice distances of sound are worth little, and phonemes alone are
used.

Faces expected (predicted in the mean) from sound are not of the paper. The live expectation knows
the phonemes alone; sound shows how they were spoken: how wide a vowel was, and when within a phone
the mouth changed direction. They come from small networks with two hidden layers of rectifiers,
averaged.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.fft import dct

from lipsync.arrays import Array, Indices, in_blocks
from lipsync.errors import UserError
from lipsync.face.model import FaceModel
from lipsync.phonemes import PHONEMES, SILENCE, PhonemeEvent
from lipsync.recognition.features import FRAMES_PER_S, HOP, N_BANDS, WINDOW, log_mel

N_CEPSTRA = 13
_PRE_EMPHASIS = np.float32(0.97)
#: Frames this far below the loudest in their mean log power (30 dB, in natural log units) say
#: nothing about a voice.
_GATE = 30.0 / (10.0 / np.log(10.0))
_SMALLEST_SPREAD = 1e-3


def cepstra(samples: NDArray[np.float32]) -> Array:
    """Return the normalised cepstra of a sound, 100 a second; frame i is centred at i / 100 s.

    Parameters
    ----------
    samples : NDArray[np.float32]
        (m,) at 16 kHz.

    Returns
    -------
    Array
        (n, 13).
    """
    return _normalise(plain_cepstra(samples))


def at_times(frames: Array, times_s: Array) -> Array:
    """Return cepstra interpolated linearly at `times_s`; outside the sound its end frames.

    Parameters
    ----------
    frames : Array
        (n, 13) cepstra, 100 a second from 0 s on.
    times_s : Array
        (m,) s.

    Returns
    -------
    Array
        (m, 13).
    """
    frame_times_s = np.arange(len(frames)) / FRAMES_PER_S
    return np.stack([np.interp(times_s, frame_times_s, column) for column in frames.T], axis=1)


def plain_cepstra(samples: NDArray[np.float32]) -> Array:
    """Return the cepstra of a sound, not normalised; frame i has its middle at i / 100 s.

    c_k = sqrt(2 / 40) sum_b m_b cos(pi k (b + 1/2) / 40) over the bands m_b; for c_0 the
    factor is sqrt(1 / 40).

    Parameters
    ----------
    samples : NDArray[np.float32]
        (m,) at 16 kHz.

    Returns
    -------
    Array
        (n, 13).
    """
    # A window before the first sample's middle, and one after the last's, are half silence.
    padded = np.concatenate([np.zeros(WINDOW // 2, np.float32), samples])
    padded = np.concatenate([padded, np.zeros(WINDOW + HOP, np.float32)])
    emphasised = padded[1:] - _PRE_EMPHASIS * padded[:-1]
    n_frames = len(samples) // HOP + 1

    def bands_of(rows: slice) -> Array:
        end = min(rows.stop, n_frames) - 1
        return log_mel(emphasised[(rows.start or 0) * HOP : end * HOP + WINDOW]).astype(np.float64)

    bands = in_blocks(bands_of, n_frames)
    return np.asarray(dct(bands, norm="ortho", axis=1)[:, :N_CEPSTRA])


def is_heard(cepstra: Array) -> NDArray[np.bool_]:
    """Return for each frame whether it is audible: within 30 dB of the loudest frame.

    Parameters
    ----------
    cepstra : Array
        (n, 13), plain cepstra.

    Returns
    -------
    NDArray[np.bool_]
        (n,).
    """
    loudness = cepstra[:, 0] / np.sqrt(N_BANDS)
    return np.asarray(loudness >= loudness.max() - _GATE)


def _normalise(found: Array) -> Array:
    """Return cepstra (n, 13), each coefficient with mean 0 and spread 1 over the audible frames."""
    heard = found[is_heard(found)]
    return np.asarray((found - heard.mean(axis=0)) / (heard.std(axis=0) + _SMALLEST_SPREAD))


@dataclass(frozen=True, slots=True)
class VoiceLikeness:
    """A learned voice: mean (m,) and precision (m, m) of its lines' mean cepstra, a Gaussian.

    limit: the greatest `distance` at which a line counts as spoken by that voice.
    """

    mean: Array
    precision: Array
    limit: float

    def distance(self, samples: NDArray[np.float32]) -> float:
        """Return the squared Mahalanobis distance of a line from the learned voice, divided by m.

        Parameters
        ----------
        samples : NDArray[np.float32]
            (n,) at 16 kHz.

        Returns
        -------
        float
            0 or more; 1 on average for the lines of the learned voice.
        """
        difference = mean_cepstrum(samples) - self.mean
        return float(difference @ self.precision @ difference) / len(difference)

    def knows(self, samples: NDArray[np.float32]) -> bool:
        """Return whether a line is near enough to the learned voice for its sound to be used.

        Parameters
        ----------
        samples : NDArray[np.float32]
            (n,) at 16 kHz.

        Returns
        -------
        bool
            True for a `distance` up to `limit`.
        """
        return self.distance(samples) <= self.limit


def mean_cepstrum(samples: NDArray[np.float32]) -> Array:
    """Return a sound's mean cepstrum over its audible frames, without the first (its level).

    Parameters
    ----------
    samples : NDArray[np.float32]
        (n,) at 16 kHz.

    Returns
    -------
    Array
        (12,).
    """
    cepstra = plain_cepstra(samples)
    return np.asarray(cepstra[is_heard(cepstra), 1:].mean(axis=0))


Array32 = NDArray[np.float32]

#: Articulation is read in windows of one recorded frame, so many before and after a moment.
_WINDOW, _N_WINDOWS = 4, 8
#: Sound is read every 20 ms, 160 ms to both sides; more of it tells words apart, not faces.
_SOUND_STEP, _SOUND_REACH = 2, 8
_INDEX_OF = {phoneme: index for index, phoneme in enumerate(PHONEMES)}


def line_inputs(
    events: Sequence[PhonemeEvent], cepstra: Array, times_s: Array, articulation: Array32
) -> Array32:
    """Return the inputs of `SoundExpectation` at each time: phonemes, articulation, sound nearby.

    Parameters
    ----------
    events : Sequence[PhonemeEvent]
        Phones of a line.
    cepstra : Array
        (m, 13), 100 a second.
    times_s : Array
        (n,) s.
    articulation : Array32
        (40, n_features), the articulation of each phoneme.

    Returns
    -------
    Array32
        (n, n_inputs): mean articulation in 16 windows of 40 ms, 1 for the present phoneme and 0 for
        the 39 others, and 17 frames of cepstra, 20 ms apart.
    """
    frames = np.rint(times_s * FRAMES_PER_S).astype(np.int64)
    margin = _N_WINDOWS * _WINDOW
    phonemes = _phonemes_on_grid(events, int(frames.max(initial=0)) + 1, margin)
    # Means of the windows as differences of running sums.
    summed = np.cumsum(articulation[phonemes], axis=0, dtype=np.float64)
    summed = np.concatenate([np.zeros((1, summed.shape[1])), summed])
    window_starts = frames[:, None] + margin + np.arange(-_N_WINDOWS, _N_WINDOWS) * _WINDOW
    windows = (summed[window_starts + _WINDOW] - summed[window_starts]) / _WINDOW
    one_hot = np.eye(len(PHONEMES))[phonemes[frames + margin]]
    offsets = np.arange(-_SOUND_REACH, _SOUND_REACH + 1) * _SOUND_STEP
    sound = cepstra[np.clip(frames[:, None] + offsets, 0, len(cepstra) - 1)]
    n = len(frames)
    joined = np.concatenate([windows.reshape(n, -1), one_hot, sound.reshape(n, -1)], axis=1)
    return joined.astype(np.float32)


def _phonemes_on_grid(
    events: Sequence[PhonemeEvent], n_frames: int, margin: int
) -> NDArray[np.int64]:
    """Return phoneme numbers, one per 10 ms: (n_frames + 2 margin,), with SIL in margins and gaps.

    margin: number of frames before and after the line, in which nothing is said.
    """
    grid = np.full(n_frames + 2 * margin, _INDEX_OF[SILENCE], dtype=np.int64)
    for event in events:
        first = round(event.start_s * FRAMES_PER_S) + margin
        end_s = n_frames / FRAMES_PER_S if event.end_s is None else event.end_s
        grid[first : round(end_s * FRAMES_PER_S) + margin] = _INDEX_OF[event.phoneme]
    return grid


@dataclass(frozen=True, slots=True)
class SoundExpectation:
    """m networks that predict a mouth's mean motion from phones and sound; their mean is used.

    articulation: (40, n_features), for `line_inputs`, which makes the inputs. mean, spread:
    (n_inputs,), of the inputs in training. layers: weights (m, n_in, n_out) and bias (m, 1, n_out)
    of each layer, alternating; the outputs of the last layer are faces (n, n_components) of the
    face model.
    """

    articulation: Array32
    mean: Array32
    spread: Array32
    layers: tuple[Array32, ...]

    def faces(self, events: Sequence[PhonemeEvent], cepstra: Array, times_s: Array) -> Array:
        """Return the faces expected at `times_s` from a line's phones and sound.

        Parameters
        ----------
        events : Sequence[PhonemeEvent]
            Phones of the line.
        cepstra : Array
            (m, 13), normalised, 100 a second.
        times_s : Array
            (n,) s.

        Returns
        -------
        Array
            (n, n_components).
        """
        inputs = line_inputs(events, cepstra, times_s, self.articulation)
        # (m, n, width): all networks at once; the last layer has no rectifier.
        value = ((inputs - self.mean) / self.spread)[None]
        for weights, bias in zip(self.layers[::2], self.layers[1::2], strict=True):
            value = np.matmul(value, weights) + bias
            if weights is not self.layers[-2]:
                value = np.maximum(value, 0.0)
        return np.asarray(value.mean(axis=0), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class Units:
    """Stored units, pieces of the recordings: unit i is the frames first_i <= f < end_i.

    Each lies around one phone.

    phonemes: (n,), the phones' numbers in PHONEMES; first, end: (n,).
    """

    phonemes: Indices
    first: Indices
    end: Indices

    def of(self, phoneme: int) -> Indices:
        """Return the numbers of all units of a phoneme, given by its number in PHONEMES."""
        return np.flatnonzero(self.phonemes == phoneme)


@dataclass(frozen=True, slots=True)
class StateModel:
    """The states and stored units (pieces of recordings) of all sentences, stored end to end.

    frame_rate_hz: of motion and cepstra. borders: (n_sentences + 1,), first frame of each sentence,
    and the end. cepstra: (n, m) float32. states: (n,), number of each frame's state. units: over
    the same frames. follows: (n_states, n_states), T of equation (S2): whether the second state may
    follow the first. means (n_states, 2 p) and covariances (n_states, 2 p, 2 p): of positions and
    speeds (per frame) in the p components of this model, which mean_mm (n_coordinates,) and basis
    (p, n_coordinates) define.
    """

    frame_rate_hz: float
    borders: Indices
    cepstra: NDArray[np.float32]
    states: Indices
    units: Units
    follows: NDArray[np.bool_]
    means: Array
    covariances: Array
    mean_mm: Array
    basis: Array

    @property
    def n_states(self) -> int:
        """The number of states, each with a mean and a covariance."""
        return len(self.means)

    @property
    def n_components(self) -> int:
        """The number p of components of this model's own basis."""
        return len(self.basis)

    def sentence_of(self, frame: int) -> tuple[int, int]:
        """Return the first frame of the sentence that contains `frame`, and one past its last."""
        sentence = int(np.searchsorted(self.borders, frame, side="right")) - 1
        return int(self.borders[sentence]), int(self.borders[sentence + 1])


class OfflineModelError(UserError):
    """Error for an offline model that cannot be used; the message says why and what to do."""


@dataclass(frozen=True, slots=True)
class OfflineModel:
    """All that scripted lines are rendered with, learned from one corpus for one face model.

    face_checksum: of that face model. training_sentences: by name. provenance: corpus, seed,
    amount.
    """

    face_checksum: str
    states: StateModel
    sound: SoundExpectation
    voice: VoiceLikeness
    training_sentences: tuple[str, ...]
    provenance: Mapping[str, str | int | float]

    def check_face(self, face: FaceModel, name: str) -> None:
        """Raise OfflineModelError if this model was made for another face model than `face`.

        name: the file of this model, for the error message.
        """
        if face.checksum != self.face_checksum:
            raise OfflineModelError(
                f"{name}: made for face model {self.face_checksum}, this face is {face.checksum}; "
                "make one with `lipservo learn offline CORPUS --model FACE -o FILE`"
            )
