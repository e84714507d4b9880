"""Augmentation of training speech: level, speed, room, noise, line."""

from dataclasses import dataclass

import numpy as np
import soxr
from numpy.typing import NDArray

from lipsync.arrays import Array32
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.recognition.features import FRAMES_PER_S
from lipsync.recognition.training import noise

Labels = NDArray[np.int64]

#: The recipe's gain was -25..+5 dB and lost .12 at -30 dB; -40 covers it.
_GAIN_DB = (-40.0, 5.0)
_SNR_DB = (3.0, 30.0)
_SPEED = (0.88, 1.12)


@dataclass(frozen=True, slots=True)
class LabelledSamples:
    """Samples (n,) float32 at 16 kHz and the label of each 10 ms frame."""

    samples: Array32
    labels: Labels


def augment_lightly(rng: np.random.Generator, clean: LabelledSamples) -> LabelledSamples:
    """Only another loudness."""
    return LabelledSamples(_at_level(rng, clean.samples, -12.0, 5.0), clean.labels)


def augment_heavily(
    rng: np.random.Generator, clean: LabelledSamples, babble: noise.Noise
) -> LabelledSamples:
    """Another speed, room, line, noise, loudness: each with its own chance."""
    changed = _at_speed(rng, clean) if rng.random() < 0.6 else clean
    samples = changed.samples
    if rng.random() < 0.25:
        samples = noise.reverberate(rng, samples)
    if rng.random() < 0.75:
        makers = (noise.white, noise.coloured, noise.coloured, noise.chords, babble)
        added = makers[rng.integers(len(makers))](rng, len(samples))
        samples = noise.add_noise(samples, added, rng.uniform(*_SNR_DB))
    if rng.random() < 0.12:
        samples = noise.telephone(samples)
    elif rng.random() < 0.12:
        samples = noise.lossy(rng, samples)
    if rng.random() < 0.08:
        samples = np.clip(samples * np.float32(10.0 ** rng.uniform(0.3, 1.2)), -1.0, 1.0)
    return LabelledSamples(_at_level(rng, samples, *_GAIN_DB), changed.labels)


def no_speech(rng: np.random.Generator, n: int) -> Array32:
    """Noise alone at any level down to nothing, now and then with a pause."""
    makers = (noise.white, noise.coloured, noise.chords)
    samples = makers[rng.integers(3)](rng, n) * np.float32(10.0 ** (rng.uniform(-75.0, -8.0) / 20))
    if rng.random() < 0.5:
        first, last = np.sort(rng.integers(0, n, 2))
        samples[first:last] *= np.float32(10.0 ** (-rng.uniform(0.0, 100.0) / 20))
    clipped: Array32 = np.clip(samples, -1.0, 1.0)
    return clipped.astype(np.float32)


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
