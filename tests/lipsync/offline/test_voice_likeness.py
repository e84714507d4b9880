"""Another voice is told by its mean cepstrum, whatever is said and however loud."""

import numpy as np
import pytest
from lipservo_lab.learning.offline.offline_training import fit_voice_likeness
from scipy.signal import lfilter

from lipsync.offline.offline_model import mean_cepstrum


def line(seed, tilt):
    """A second of noise with a spectral tilt of its own: a vocal tract that never changes."""
    noise = np.random.default_rng(seed).normal(0.0, 0.1, 16_000)
    return lfilter([1.0], [1.0, -tilt], noise).astype(np.float32)


VOICE = fit_voice_likeness([mean_cepstrum(line(seed, 0.6)) for seed in range(40)])


def test_a_new_line_of_the_voice_is_known_and_another_voice_is_not():
    assert VOICE.knows(line(100, 0.6))
    assert not VOICE.knows(line(100, 0.3))
    assert not VOICE.knows(line(100, 0.8))


def test_a_quieter_line_is_as_near():
    quiet = line(101, 0.6) * np.float32(0.3)

    assert VOICE.distance(quiet) == pytest.approx(VOICE.distance(line(101, 0.6)), rel=0.05)


def test_the_voice_itself_is_one_off_on_average():
    distances = [VOICE.distance(line(seed, 0.6)) for seed in range(40)]

    assert np.mean(distances) == pytest.approx(39 / 40, abs=0.05)
