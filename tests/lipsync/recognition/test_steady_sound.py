"""Sound that stands still is told from voices."""

import numpy as np
import pytest
import scipy.signal
import soundfile
from speech import CLIP_PATH

from lipsync.recognition.features import LogMelStream
from lipsync.recognition.own_noise import STEADY_S, SteadySoundDetector

RATE_HZ = 16_000
TIME_S = np.arange(6 * RATE_HZ) / RATE_HZ


def steady(samples):
    detector = SteadySoundDetector()
    frames = LogMelStream().push(samples.astype(np.float32))
    return np.array([detector.push(frame) for frame in frames])


@pytest.mark.parametrize(
    "wave",
    [
        scipy.signal.square(2 * np.pi * 50 * TIME_S),
        scipy.signal.sawtooth(2 * np.pi * 120 * TIME_S),
        np.sin(2 * np.pi * 1_000 * TIME_S),
    ],
    ids=["square", "sawtooth", "whistle"],
)
def test_a_buzz_is_steady_within_two_seconds_at_any_level(wave):
    for level in (0.3, 0.003):
        assert steady(level * wave)[190:].all()


def test_a_buzz_that_is_switched_on_is_heard_and_then_known():
    wave = 0.1 * scipy.signal.sawtooth(2 * np.pi * 120 * TIME_S) * (TIME_S > 2.0)
    found = steady(wave)
    assert not found[200:220].any()
    assert found[-100:].all()


def test_no_frame_of_speech_is_steady_alone_or_beside_a_hum():
    clip = soundfile.read(CLIP_PATH, dtype="float32")[0]
    levels_db = 20 * np.log10(np.abs(clip[: len(clip) // 160 * 160]).reshape(-1, 160).max(1) + 1e-9)
    is_loud = levels_db > levels_db.max() - 20
    hum = np.sin(2 * np.pi * 100 * np.arange(len(clip)) / RATE_HZ)
    for sound in (clip, clip + 0.1 * np.std(clip) * hum.astype(np.float32)):
        found = steady(sound)
        assert found[is_loud[: len(found)]].mean() < 0.01


def test_a_closure_in_a_hum_is_shorter_than_what_counts_as_steady():
    assert STEADY_S > 0.15
    voice = np.sin(2 * np.pi * 700 * TIME_S) * (TIME_S % 0.5 > 0.15)
    assert not steady(0.3 * voice + 0.01 * np.sin(2 * np.pi * 100 * TIME_S))[100:].any()


def test_a_hum_is_known_as_soon_after_a_minute_of_silence_as_after_two_seconds():
    hum = 0.1 * scipy.signal.sawtooth(2 * np.pi * 120 * TIME_S[: 3 * RATE_HZ])
    short, long = (
        steady(np.concatenate((np.zeros(seconds * RATE_HZ), hum))) for seconds in (2, 60)
    )
    np.testing.assert_array_equal(long[6000:], short[200:])
    assert not long[6000:6020].any()
    assert long[-50:].all()
