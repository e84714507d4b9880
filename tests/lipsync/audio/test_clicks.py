"""The delay of clicks in recordings of which it is known."""

import numpy as np
import pytest
import soxr
from hypothesis import given, settings
from hypothesis import strategies as st

from lipsync.audio.delay import CLICKS_S, click_train, find_delay
from lipsync.audio.source import SoundError

RATE_HZ = 16_000
BEGINS_S = 1.0
EXPECTED_S = BEGINS_S + np.array(CLICKS_S)


def recording(delay_s, level=0.1, sound=None):
    """Eight seconds in which the clicks are so late; silence else."""
    train = click_train(RATE_HZ) if sound is None else sound
    heard = np.zeros(8 * RATE_HZ, dtype=np.float32)
    first = round((BEGINS_S + delay_s) * RATE_HZ)
    heard[first : first + len(train)] = level * train
    return heard


def noise(level, seed=1):
    rng = np.random.default_rng(seed)
    return (level * rng.standard_normal(8 * RATE_HZ)).astype(np.float32)


@settings(max_examples=25)
@given(st.floats(-0.45, 1.95), st.floats(0.01, 1.0), st.sampled_from((1.0, -1.0)))
def test_a_delay_is_found_to_a_sample_whatever_the_level_and_polarity(delay_s, level, sign):
    found = find_delay(recording(delay_s, sign * level), EXPECTED_S)
    assert found.median_s == pytest.approx(delay_s, abs=1 / RATE_HZ)
    assert (found.n_found, found.n_played) == (7, 7)
    assert found.spread_s < 2 / RATE_HZ


def test_a_train_played_at_48_khz_is_the_same_train():
    sound = soxr.resample(click_train(48_000), 48_000, RATE_HZ)
    found = find_delay(recording(0.1, 1.0, sound), EXPECTED_S)
    assert found.median_s == pytest.approx(0.1, abs=2 / RATE_HZ)


def test_noise_as_loud_as_the_clicks_does_no_harm():
    """Root mean square of a click: 0.03 at this level."""
    found = find_delay(recording(0.25) + noise(0.02), EXPECTED_S)
    assert found.median_s == pytest.approx(0.25, abs=5e-4)


def test_an_echo_is_not_taken_for_the_click():
    heard = recording(0.03)
    heard[480:] += 0.7 * heard[:-480].copy()
    heard[1600:] += 0.5 * heard[:-1600].copy()
    assert find_delay(heard, EXPECTED_S).median_s == pytest.approx(0.03, abs=5e-4)


def test_a_door_that_slams_is_not_taken_for_a_click():
    heard = recording(0.03)
    heard[40_000:40_800] = 1.0
    heard[60_000:61_000] += noise(0.5)[:1_000]
    assert find_delay(heard, EXPECTED_S).median_s == pytest.approx(0.03, abs=5e-4)


def test_two_clicks_may_be_drowned():
    heard = recording(0.08)
    for each_s in (CLICKS_S[1], CLICKS_S[4]):
        first = round((BEGINS_S + 0.08 + each_s) * RATE_HZ)
        heard[first : first + 800] = 0.0
    found = find_delay(heard, EXPECTED_S)
    assert found.n_found == 5
    assert found.median_s == pytest.approx(0.08, abs=1 / RATE_HZ)


@pytest.mark.parametrize(
    ("heard", "message"),
    [
        (np.zeros(8 * RATE_HZ, np.float32), "the microphone recorded no sound"),
        (np.zeros(0, np.float32), "the microphone recorded no sound"),
        (noise(0.1), "of 7 clicks were heard: too quiet, too much noise, or another microphone"),
        (recording(0.1)[: 4 * RATE_HZ], "only 4 of 7 clicks were heard"),
        (recording(0.1, 0.1) + noise(0.5), "of 7 clicks were heard"),
    ],
    ids=["silence", "no sound", "noise", "too short", "drowned"],
)
def test_a_recording_that_tells_nothing_is_refused(heard, message):
    with pytest.raises(SoundError, match=message):
        find_delay(heard, EXPECTED_S)


@settings(max_examples=25)
@given(st.integers(0, 10_000))
def test_noise_alone_is_never_taken_for_clicks(seed):
    with pytest.raises(SoundError, match="clicks were heard"):
        find_delay(noise(0.1, seed), EXPECTED_S)


def test_clicks_that_scatter_are_refused():
    scattered_s = EXPECTED_S + np.array([0.0, 0.0, 0.0, 0.0, 0.011, 0.0, 0.0])
    with pytest.raises(SoundError, match="11 ms apart"):
        find_delay(recording(0.1), scattered_s)


def test_no_two_distances_between_clicks_are_alike():
    distances = np.subtract.outer(CLICKS_S, CLICKS_S)
    distances = np.sort(distances[distances > 0.0])
    assert np.min(np.diff(distances)) > 0.039
