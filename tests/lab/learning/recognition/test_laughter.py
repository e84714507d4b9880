"""Laughter made of a voice's own vowels."""

import numpy as np
from lipservo_lab.learning.recognition.nonspeech_sounds import laughter_of

from lipsync.phonemes import PHONEMES, SILENCE

RATE_HZ = 16_000
VOWEL, SIL = PHONEMES.index("AA"), PHONEMES.index(SILENCE)


def a_vowel(pitch_hz=120.0):
    samples = np.zeros(RATE_HZ, np.float32)
    time_s = np.arange(4_800) / RATE_HZ
    samples[6_400:11_200] = np.sign(np.sin(2 * np.pi * pitch_hz * time_s))
    labels = np.full(100, SIL)
    labels[40:70] = VOWEL
    return samples, labels


def test_it_comes_four_to_seven_times_a_second_with_pauses():
    laughter = laughter_of([a_vowel()])(np.random.default_rng(1), 20 * RATE_HZ)
    level = np.sqrt(np.mean(laughter.reshape(-1, 160) ** 2, axis=1))
    loud = np.convolve(level, np.hanning(7) / 3.0, "same")
    peaks = np.flatnonzero((loud[1:-1] > loud[:-2]) & (loud[1:-1] > loud[2:]) & (loud[1:-1] > 1.0))
    apart_s = np.diff(peaks) / 100
    usual_s = np.median(apart_s[apart_s < 0.4])
    assert 1 / 7.5 < usual_s < 1 / 3.5
    assert np.mean(level < 0.1) > 0.1, "bouts have pauses between them"


def test_the_same_seed_laughs_alike_and_without_vowels_nobody_does():
    laugh = laughter_of([a_vowel()])
    first, again = (laugh(np.random.default_rng(3), RATE_HZ) for _ in range(2))
    assert np.array_equal(first, again)
    silent = laughter_of([(np.ones(RATE_HZ, np.float32), np.full(100, SIL))])
    assert not silent(np.random.default_rng(3), RATE_HZ).any()
