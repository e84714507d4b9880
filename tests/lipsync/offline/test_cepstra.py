"""Cepstra: the transform worked out, where a frame lies, and what normalising takes away."""

import numpy as np
import pytest

from lipsync.offline.offline_model import N_CEPSTRA, at_times, cepstra, plain_cepstra
from lipsync.recognition.features import log_mel


def voice(seconds=1.0, swells=True):
    rng = np.random.default_rng(0)
    n = round(16_000 * seconds)
    swell = 0.5 + 0.4 * np.sin(np.arange(n) / 700.0) * swells
    return (rng.normal(0, 0.1, n) * swell).astype(np.float32)


def test_a_cepstrum_is_the_cosine_transform_of_the_log_bands():
    samples = voice()
    emphasised = samples[1:] - np.float32(0.97) * samples[:-1]
    # Frame 10 of the cepstra has its middle at sample 1600, so it begins 200 samples before.
    bands = log_mel(emphasised[1400:1800])[0].astype(np.float64)
    b = np.arange(40)
    worked = [
        np.sqrt((2 if k else 1) / 40) * (bands * np.cos(np.pi * k * (b + 0.5) / 40)).sum()
        for k in range(N_CEPSTRA)
    ]

    assert plain_cepstra(samples)[10] == pytest.approx(worked, abs=1e-4)


def test_a_click_is_loudest_in_the_frame_at_its_time():
    samples = np.zeros(16_000, np.float32)
    samples[8_000] = 1.0

    loudness = plain_cepstra(samples)[:, 0]

    assert abs(int(loudness.argmax()) - 50) <= 1
    assert loudness[47:50] == pytest.approx(loudness[51:54][::-1], abs=0.5)


def test_level_falls_out():
    samples = voice()

    quiet = cepstra(samples * np.float32(0.3))

    # The first and the last window hold silence, which has no level.
    assert cepstra(samples)[2:-2] == pytest.approx(quiet[2:-2], abs=0.1)


def test_what_is_heard_has_mean_0_and_spread_1():
    found = cepstra(voice(swells=False))

    assert found.mean(axis=0) == pytest.approx(np.zeros(N_CEPSTRA), abs=0.3)
    assert found.std(axis=0) == pytest.approx(np.ones(N_CEPSTRA), abs=0.3)


def test_times_between_frames_lie_between_them_and_times_beyond_take_the_ends():
    found = np.array([[0.0], [10.0], [20.0]])

    assert at_times(found, np.array([-1.0, 0.005, 0.02, 9.0])).ravel().tolist() == [0, 5, 20, 20]
