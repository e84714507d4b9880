"""Augmentation of training speech: voice, speed, room, noise, line, level.

The same words by other voices: a shorter or longer vocal tract, shouting, whisper.

Samples are (n,) float32 at 16 kHz and stay as long as they were, so that labels keep their times.
"""

from dataclasses import dataclass

import numpy as np
import soxr
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.signal import lfilter

from lipservo_lab.learning.recognition import noise, nonspeech_sounds
from lipservo_lab.learning.recognition.noise import Noise
from lipsync.arrays import Array32
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.phonemes import PHONEMES, SILENCE
from lipsync.recognition.features import FRAMES_PER_S, HOP

#: Of the frames that are laid over one another, and how far each may be moved to fit.
_FRAME, _REACH = 480, 120
_N_FFT, _HOP = 512, 128


def warped(samples: Array32, factor: float) -> Array32:
    """Return speech with all frequencies times `factor`, as of a smaller vocal tract and larynx.

    The sound is stretched in time by WSOLA (Verhelst and Roelands, ICASSP 1993) and resampled back
    to its length: 1.15 makes a woman of a man, 1.35 a child.

    Parameters
    ----------
    samples : Array32
        (n,) at 16 kHz.
    factor : float
        Above 0.

    Returns
    -------
    Array32
        (n,).
    """
    stretched = _stretched(samples, factor)
    back = soxr.resample(stretched, SAMPLE_RATE_HZ * factor, SAMPLE_RATE_HZ)
    return _fitted(back, len(samples))


def shouted(rng: np.random.Generator, samples: Array32) -> Array32:
    """Return speech with more effort: flatter spectrum, raised pitch, loud parts compressed.

    Parameters
    ----------
    rng : np.random.Generator
        Draws the amounts.
    samples : Array32
        (n,) at 16 kHz.

    Returns
    -------
    Array32
        (n,).
    """
    raised = warped(samples, rng.uniform(1.03, 1.15))
    pressed = np.tanh(rng.uniform(2.0, 8.0) * raised / max(1e-6, float(np.abs(raised).max())))
    tilted = lfilter([1.0, -rng.uniform(0.2, 0.7)], [1.0], pressed)
    loudest = max(1e-6, float(np.abs(tilted).max()))
    return np.asarray(0.5 * tilted / loudest, np.float32)


def whispered(rng: np.random.Generator, samples: Array32) -> Array32:
    """Return the spectral envelope filled with noise in place of the voice, weaker in the bass.

    Parameters
    ----------
    rng : np.random.Generator
        Draws the noise.
    samples : Array32
        (n,) at 16 kHz.

    Returns
    -------
    Array32
        (n,).
    """
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
    """Return samples `factor` times longer at the same pitch (WSOLA).

    Each frame is moved to where it continues the last one best.
    """
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


Labels = NDArray[np.int64]

#: The recipe's gain was -25..+5 dB and lost .12 at -30 dB; -40 covers it.
_GAIN_DB = (-40.0, 5.0)
_SNR_DB = (2.0, 25.0)
#: Beside somebody who is louder than this nobody could tell which talker is meant.
_SECOND_TALKER_DB = (8.0, 25.0)
_SPEED = (0.88, 1.12)
#: Vocal tracts from a large man's to a small child's; adults who read are between.
_WARP = (0.85, 1.40)
#: Of the made sounds. Laughter by real vowels is hardest to tell from speech.
_LAUGHTER_SHARE = 0.15
#: Fans, hiss, traffic: the commonest noise of all, and what earlier weights heard better.
_STEADY_SHARE = 0.12
#: Heard before somebody speaks, s.
_BEFORE_S = (0.2, 1.5)
_SILENCE_INDEX = PHONEMES.index(SILENCE)


@dataclass(frozen=True, slots=True)
class LabelledSamples:
    """Samples (n,) float32 at 16 kHz and the label of each 10 ms frame."""

    samples: Array32
    labels: Labels


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What is heard beside the voice.

    babble: many others; talker: one other; laughter: of those that speak; found: files, or None
    where there are none.
    """

    babble: Noise
    talker: Noise
    laughter: Noise
    found: Noise | None = None

    def sound(self, rng: np.random.Generator, n: int) -> Array32:
        """Return a sound that is no speech: made, or found.

        Parameters
        ----------
        rng : np.random.Generator
            Chooses.
        n : int
            Samples.

        Returns
        -------
        Array32
            (n,).
        """
        if rng.random() < _STEADY_SHARE:
            return (noise.white if rng.random() < 0.5 else noise.coloured)(rng, n)
        if self.found is not None and rng.random() < 0.45:
            return self.found(rng, n)
        chance = rng.random()
        if chance < _LAUGHTER_SHARE:
            return self.laughter(rng, n)
        if chance < 0.65:
            return nonspeech_sounds.any_sound(rng, n)
        makers = (noise.white, noise.coloured, noise.chords)
        return makers[int(rng.integers(len(makers)))](rng, n)

    def beside_speech(self, rng: np.random.Generator, speech: Array32) -> Array32:
        """Return the speech with a sound, many voices or one other voice in it.

        Parameters
        ----------
        rng : np.random.Generator
            Chooses.
        speech : Array32
            (n,).

        Returns
        -------
        Array32
            (n,).
        """
        chance, n = rng.random(), len(speech)
        if chance < 0.15:
            return noise.add_noise(speech, self.babble(rng, n), rng.uniform(*_SNR_DB))
        if chance < 0.25:
            return noise.add_noise(speech, self.talker(rng, n), rng.uniform(*_SECOND_TALKER_DB))
        return noise.add_noise(speech, self.sound(rng, n), rng.uniform(*_SNR_DB))


def augment_lightly(rng: np.random.Generator, clean: LabelledSamples) -> LabelledSamples:
    """Change the loudness only."""
    return LabelledSamples(_at_level(rng, clean.samples, -12.0, 5.0), clean.labels)


def augment_heavily(
    rng: np.random.Generator, clean: LabelledSamples, around: Surroundings
) -> LabelledSamples:
    """Return a recording with another voice, speed, room, line, noise, level, each by chance."""
    changed = by_another_voice(rng, clean)
    samples = changed.samples
    if rng.random() < 0.3:
        samples = noise.reverberate(rng, samples)
    if rng.random() < 0.75:
        samples = around.beside_speech(rng, samples)
    if rng.random() < 0.12:
        samples = noise.telephone(samples)
    elif rng.random() < 0.12:
        samples = noise.lossy(rng, samples)
    if rng.random() < 0.08:
        samples = np.clip(samples * np.float32(10.0 ** rng.uniform(0.3, 1.2)), -1.0, 1.0)
    result = LabelledSamples(_at_level(rng, samples, *_GAIN_DB), changed.labels)
    return _after_a_sound(rng, result, around) if rng.random() < 0.3 else result


def no_speech(rng: np.random.Generator, n: int, around: Surroundings) -> Array32:
    """Return a sound alone at any level down to 0, sometimes with a pause, in a room, or clipped.

    Parameters
    ----------
    rng : np.random.Generator
        Chooses.
    n : int
        Samples.
    around : Surroundings
        Makes sounds.

    Returns
    -------
    Array32
        (n,).
    """
    samples = around.sound(rng, n)
    if rng.random() < 0.2:
        samples = noise.add_noise(samples, around.sound(rng, n), rng.uniform(0.0, 20.0))
    if rng.random() < 0.2:
        samples = noise.reverberate(rng, samples)
    low_db = -75.0 if rng.random() < 0.3 else -45.0
    samples = samples * np.float32(10.0 ** (rng.uniform(low_db, -8.0) / 20))
    if rng.random() < 0.4:
        first, last = np.sort(rng.integers(0, n, 2))
        samples[first:last] *= np.float32(10.0 ** (-rng.uniform(0.0, 100.0) / 20))
    clipped: Array32 = np.clip(samples, -1.0, 1.0)
    return clipped.astype(np.float32)


def by_another_voice(rng: np.random.Generator, clean: LabelledSamples) -> LabelledSamples:
    """Return a recording faster, slower, by another vocal tract, shouted, whispered, or unchanged.

    Parameters
    ----------
    rng : np.random.Generator
        Chooses.
    clean : LabelledSamples
        As recorded.

    Returns
    -------
    LabelledSamples
        As long as it was, or as the speed has made it.
    """
    chance = rng.random()
    if chance < 0.3:
        return _at_speed(rng, clean)
    if chance < 0.65:
        samples = warped(clean.samples, rng.uniform(*_WARP))
        return LabelledSamples(samples, clean.labels)
    if chance < 0.70:
        return LabelledSamples(shouted(rng, clean.samples), clean.labels)
    if chance < 0.74:
        return LabelledSamples(whispered(rng, clean.samples), clean.labels)
    return clean


def _after_a_sound(
    rng: np.random.Generator, speech: LabelledSamples, around: Surroundings
) -> LabelledSamples:
    """Speech that begins after a knock, a cough, a bar of music: as loud as itself, or less."""
    n_frames = round(rng.uniform(*_BEFORE_S) * FRAMES_PER_S)
    level = np.sqrt(np.mean(np.square(speech.samples, dtype=np.float64)))
    gain = np.float32(level * 10.0 ** (rng.uniform(-25.0, 3.0) / 20.0))
    before = np.clip(gain * around.sound(rng, n_frames * HOP), -1.0, 1.0)
    return LabelledSamples(
        np.concatenate((before.astype(np.float32), speech.samples)),
        np.concatenate((np.full(n_frames, _SILENCE_INDEX), speech.labels)),
    )


def _at_speed(rng: np.random.Generator, clean: LabelledSamples) -> LabelledSamples:
    """Faster or slower with the pitch, as a tape would."""
    speed = rng.uniform(*_SPEED)
    samples = soxr.resample(clean.samples, round(SAMPLE_RATE_HZ * speed), SAMPLE_RATE_HZ)
    n_frames = len(samples) * FRAMES_PER_S // SAMPLE_RATE_HZ
    sources = ((np.arange(n_frames) + 0.5) * speed).astype(np.int64)
    labels = clean.labels[np.minimum(sources, len(clean.labels) - 1)]
    return LabelledSamples(samples.astype(np.float32), labels)


def _at_level(rng: np.random.Generator, samples: Array32, low_db: float, high_db: float) -> Array32:
    gain = np.float32(10.0 ** (rng.uniform(low_db, high_db) / 20.0))
    # Microphones hand out 16 bits: very quiet speech is rounded.
    rounded: Array32 = np.rint(np.clip(samples * gain, -1.0, 1.0) * 32767.0) / 32767.0
    return rounded.astype(np.float32)
