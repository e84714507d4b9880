"""Laughter of real voices: one of their vowels again and again, with breath between.

A network that knows laughter by synthesis alone takes a person's for speech, vowel by vowel. What
tells it from speech is the rhythm: the same vowel four to seven times a second (Bachorowski,
Smoski and Owren, "The acoustic features of human laughter", JASA 110(3), 2001), falling in pitch
and strength.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from lipservo_lab.learning.recognition.noise import Noise, add_at, unit_power
from lipsync.arrays import Array32
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.phonemes import PHONEMES
from lipsync.recognition.features import HOP

Samples = NDArray[np.float64]

#: People laugh with open, central vowels (the same paper).
_VOWELS = frozenset(PHONEMES.index(phoneme) for phoneme in ("AA", "AE", "AH", "EH", "IH", "ER"))
_SHORTEST_FRAMES = 6


def laughter_of(voices: Sequence[tuple[Array32, NDArray[np.int64]]]) -> Noise:
    """Laughter made of the vowels of recordings: samples (n,), labels (n_frames,) each.

    Where they hold no vowel of 60 ms it is silence.
    """
    vowels = [found for samples, labels in voices if (found := _vowels(samples, labels))]

    def laugh(rng: np.random.Generator, n: int) -> Array32:
        total = 0.002 * rng.standard_normal(n)
        if not vowels:
            return np.zeros(n, np.float32)
        own = vowels[int(rng.integers(len(vowels)))]
        at = int(rng.uniform(0.0, 0.5) * SAMPLE_RATE_HZ)
        while at < n:
            vowel = own[int(rng.integers(len(own)))]
            at = _bout(rng, total, at, vowel)
            at += int(rng.uniform(0.3, 2.0) * SAMPLE_RATE_HZ)
        return unit_power(total)

    return laugh


def _vowels(samples: Array32, labels: NDArray[np.int64]) -> list[Samples]:
    edges = [0, *(np.flatnonzero(np.diff(labels)) + 1).tolist(), len(labels)]
    return [
        np.asarray(unit_power(samples[first * HOP : end * HOP]), np.float64)
        for first, end in pairwise(edges)
        if end - first >= _SHORTEST_FRAMES and labels[first] in _VOWELS
    ]


def _bout(rng: np.random.Generator, total: Samples, at: int, vowel: Samples) -> int:
    """A few bursts of the vowel into `total` from `at` on; where they end."""
    period_s, strength = rng.uniform(0.14, 0.26), 1.0
    # Laughter is higher than speech of the same person.
    pitch = rng.uniform(1.0, 1.6)
    for _ in range(int(rng.integers(3, 13))):
        length = int(period_s * rng.uniform(0.35, 0.65) * SAMPLE_RATE_HZ)
        burst = np.interp(np.arange(length) * pitch, np.arange(len(vowel)), vowel, right=0.0)
        burst *= np.hanning(length)
        breath = _breath(rng, vowel, int(period_s * SAMPLE_RATE_HZ)) * rng.uniform(0.05, 0.4)
        add_at(total, at, strength * breath)
        add_at(total, at, strength * burst)
        at += int(period_s * rng.uniform(0.93, 1.07) * SAMPLE_RATE_HZ)
        pitch, strength = pitch * rng.uniform(0.94, 1.0), strength * rng.uniform(0.82, 1.0)
    return at


def _breath(rng: np.random.Generator, vowel: Samples, n: int) -> Samples:
    """Noise with the vowel's spectrum: the mouth stays as it is, the voice is gone."""
    strengths = np.abs(np.fft.rfft(vowel, n))
    smooth = np.convolve(strengths, np.ones(9) / 9.0, "same")
    noise = np.fft.irfft(smooth * np.exp(2j * np.pi * rng.random(len(smooth))), n)
    return np.asarray(noise / max(1e-9, float(np.std(noise))))
