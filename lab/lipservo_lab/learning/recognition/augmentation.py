"""Augment training speech: other voices, speeds, rooms, noise, lines, levels.

Samples are (n,) float32 at 16 kHz. Changes of the voice (a shorter or longer vocal tract, shouting,
whisper) keep the length, so that labels keep their times; `_at_speed` moves the labels too.
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

#: WSOLA, in samples: length of the frames that are added with overlap, and how far each may be
#: moved to fit.
_FRAME, _REACH = 480, 120
_N_FFT, _HOP = 512, 128


def warped(samples: Array32, factor: float) -> Array32:
    """Return speech with all frequencies times `factor`, as of a smaller vocal tract and larynx.

    The sound is stretched in time by WSOLA (Verhelst and Roelands, ICASSP 1993) and resampled back
    to its length: 1.15 turns a man's voice into a woman's, 1.35 into a child's.

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
    resampled = soxr.resample(stretched, SAMPLE_RATE_HZ * factor, SAMPLE_RATE_HZ)
    return _of_length(resampled, len(samples))


def shouted(rng: np.random.Generator, samples: Array32) -> Array32:
    """Return speech as if louder spoken: raised pitch, loud parts compressed, flatter spectrum.

    Parameters
    ----------
    rng : np.random.Generator
        Draws the amounts.
    samples : Array32
        (n,) at 16 kHz.

    Returns
    -------
    Array32
        (n,), scaled to a peak of 0.5.
    """
    raised = warped(samples, rng.uniform(1.03, 1.15))
    compressed = np.tanh(rng.uniform(2.0, 8.0) * raised / max(1e-6, float(np.abs(raised).max())))
    flattened = lfilter([1.0, -rng.uniform(0.2, 0.7)], [1.0], compressed)
    loudest = max(1e-6, float(np.abs(flattened).max()))
    return np.asarray(0.5 * flattened / loudest, np.float32)


def whispered(rng: np.random.Generator, samples: Array32) -> Array32:
    """Return speech with its spectral envelope on noise in place of the voice, weaker in the bass.

    Parameters
    ----------
    rng : np.random.Generator
        Draws the noise and how much bass is left.
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
    # The envelope: a mean over nine bins leaves no harmonics of the voice.
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

    Each frame is taken from where the sound, up to `_REACH` samples around the frame's place, is
    most similar to the continuation of the frame before.
    """
    step = _FRAME // 2
    window = np.hanning(_FRAME + 1)[:-1].astype(np.float32)
    n_out = round(len(samples) * factor)
    padded = np.pad(samples, (_REACH, _FRAME + step + 2 * _REACH))
    total = np.zeros(n_out + _FRAME, np.float32)
    continued: Array32 = padded[_REACH : _REACH + _FRAME]
    for start in range(0, n_out, step):
        first = round(start / factor)
        region = padded[first : first + _FRAME + 2 * _REACH]
        if len(region) < _FRAME + 2 * _REACH:
            break
        # Every fourth place, and every fourth sample of it, is enough to find the best one.
        candidates = sliding_window_view(region, _FRAME)[: 2 * _REACH : 4, ::4]
        best = 4 * int((candidates @ continued[::4]).argmax())
        total[start : start + _FRAME] += window * region[best : best + _FRAME]
        next_first = first + best + step
        continued = padded[next_first : next_first + _FRAME]
        if len(continued) < _FRAME:
            break
    return total[:n_out]


def _of_length(samples: Array32, n: int) -> Array32:
    """Return the first `n` samples, with zeros behind them if there are fewer."""
    fitted = np.zeros(n, np.float32)
    fitted[: min(n, len(samples))] = samples[:n]
    return fitted


Labels = NDArray[np.int64]

#: Gain of heavily augmented copies. Weights trained with -25 to +5 dB recognised .12 less at -30
#: dB; -40 covers that level.
_GAIN_DB = (-40.0, 5.0)
_SNR_DB = (2.0, 25.0)
#: How far a second talker is below the first. If both were equally loud, it would be undecided
#: whose phonemes are to be recognised.
_SECOND_TALKER_DB = (8.0, 25.0)
_SPEED = (0.88, 1.12)
#: Factors on all frequencies, for vocal tracts from a large man's to a small child's; the adults
#: who read are between.
_WARP = (0.85, 1.40)
#: Share of laughter among the synthetic sounds; laughter of real vowels is hardest to tell from
#: speech.
_LAUGHTER_SHARE = 0.15
#: Fans, hiss, traffic: the commonest noise of all, and what earlier weights heard better.
_STEADY_SHARE = 0.12
#: Duration of a sound before the speech begins, s.
_BEFORE_S = (0.2, 1.5)
_SILENCE_INDEX = PHONEMES.index(SILENCE)


@dataclass(frozen=True, slots=True)
class LabelledSamples:
    """Samples (n,) float32 at 16 kHz, and the label of each 10 ms frame, (n_frames,)."""

    samples: Array32
    labels: Labels


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Makers of sounds that are heard besides the voice.

    babble: many voices at once; talker: one other voice; laughter: made of vowels of the same
    voices; found: parts of sound files without speech, or None.
    """

    babble: Noise
    talker: Noise
    laughter: Noise
    found: Noise | None = None

    def sound(self, rng: np.random.Generator, n: int) -> Array32:
        """Return a sound without speech: steady noise, a part of a found file, or a synthetic one.

        Parameters
        ----------
        rng : np.random.Generator
            Draws all choices.
        n : int
            Number of samples.

        Returns
        -------
        Array32
            (n,) at 16 kHz.
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
        """Return the speech mixed with many voices, one other voice, or a sound without speech.

        Parameters
        ----------
        rng : np.random.Generator
            Chooses, and draws the signal-to-noise ratio.
        speech : Array32
            (n,) at 16 kHz.

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
    """Return a recording at another level: -12 to +5 dB."""
    return LabelledSamples(_at_level(rng, clean.samples, -12.0, 5.0), clean.labels)


def augment_heavily(
    rng: np.random.Generator, clean: LabelledSamples, around: Surroundings
) -> LabelledSamples:
    """Return a recording with other voice, speed, room, line, noise and level, each by chance.

    In three of ten cases a sound without speech comes before it, with labels of silence.
    """
    revoiced = by_another_voice(rng, clean)
    samples = revoiced.samples
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
    augmented = LabelledSamples(_at_level(rng, samples, *_GAIN_DB), revoiced.labels)
    return _prepend_sound(rng, augmented, around) if rng.random() < 0.3 else augmented


def no_speech(rng: np.random.Generator, n: int, around: Surroundings) -> Array32:
    """Return a sound without speech, at a level drawn from the range below -8 dB.

    By chance it is mixed with another one, in a room, or has a part at a lower level.

    Parameters
    ----------
    rng : np.random.Generator
        Draws all choices.
    n : int
        Number of samples.
    around : Surroundings
        Makes sounds.

    Returns
    -------
    Array32
        (n,) at 16 kHz, clipped to -1 to 1.
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
    """Return a recording faster, slower, of another vocal tract, shouted, whispered, or unchanged.

    Parameters
    ----------
    rng : np.random.Generator
        Draws all choices.
    clean : LabelledSamples
        The recording to change.

    Returns
    -------
    LabelledSamples
        With a new length and moved labels at another speed, else of the same length.
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


def _prepend_sound(
    rng: np.random.Generator, speech: LabelledSamples, around: Surroundings
) -> LabelledSamples:
    """Return speech after a sound without speech, which lasts 0.2 to 1.5 s and is labelled silence.

    The sound is 25 dB weaker to 3 dB stronger than the speech.
    """
    n_frames = round(rng.uniform(*_BEFORE_S) * FRAMES_PER_S)
    speech_rms = np.sqrt(np.mean(np.square(speech.samples, dtype=np.float64)))
    gain = np.float32(speech_rms * 10.0 ** (rng.uniform(-25.0, 3.0) / 20.0))
    sound = np.clip(gain * around.sound(rng, n_frames * HOP), -1.0, 1.0)
    return LabelledSamples(
        np.concatenate((sound.astype(np.float32), speech.samples)),
        np.concatenate((np.full(n_frames, _SILENCE_INDEX), speech.labels)),
    )


def _at_speed(rng: np.random.Generator, clean: LabelledSamples) -> LabelledSamples:
    """Return a recording faster or slower, its pitch changed alike, with its labels moved."""
    speed = rng.uniform(*_SPEED)
    samples = soxr.resample(clean.samples, round(SAMPLE_RATE_HZ * speed), SAMPLE_RATE_HZ)
    n_frames = len(samples) * FRAMES_PER_S // SAMPLE_RATE_HZ
    source_frames = ((np.arange(n_frames) + 0.5) * speed).astype(np.int64)
    labels = clean.labels[np.minimum(source_frames, len(clean.labels) - 1)]
    return LabelledSamples(samples.astype(np.float32), labels)


def _at_level(rng: np.random.Generator, samples: Array32, low_db: float, high_db: float) -> Array32:
    """Return samples with a gain between `low_db` and `high_db`, clipped and rounded to 16 bits."""
    gain = np.float32(10.0 ** (rng.uniform(low_db, high_db) / 20.0))
    # Microphones hand out 16 bits: very quiet speech is rounded.
    rounded: Array32 = np.rint(np.clip(samples * gain, -1.0, 1.0) * 32767.0) / 32767.0
    return rounded.astype(np.float32)
