import numpy as np
import pytest
import soundfile
from speech import CLIP_PATH, white_noise

from lipsync.recognition.voice_activity import FRAMES_PER_S, VoiceActivityDetector, level_db

FRAME = 160


def levels_db(samples):
    whole = samples[: len(samples) // FRAME * FRAME].astype(np.float32)
    return np.array([level_db(frame) for frame in whole.reshape(-1, FRAME)])


def open_frames(samples):
    gate = VoiceActivityDetector()
    return np.array([gate.push(db) for db in levels_db(samples)])


@pytest.fixture(scope="module")
def clip():
    return soundfile.read(CLIP_PATH, dtype="float32")[0]


def test_the_level_of_white_noise_is_its_rms():
    levels = levels_db(white_noise(5.0, level_db=-40.0))

    assert np.mean(levels) == pytest.approx(-40.0, abs=0.2)


def test_offset_and_hum_have_no_level():
    t_s = np.arange(16_000) / 16_000

    assert levels_db(np.full(16_000, 0.5)).max() < -110.0
    assert levels_db(0.1 * np.sin(2 * np.pi * 50 * t_s)).max() < -45.0  # itself at -23


@pytest.mark.parametrize("level", [-70.0, -50.0, -26.0, -10.0])
def test_steady_noise_is_no_speech_after_a_second_and_a_half(level):
    is_open = open_frames(white_noise(10.0, level))

    assert not is_open[150:].any()


def test_digital_silence_is_never_speech():
    assert not open_frames(np.zeros(32_000)).any()


def test_rumble_is_hardly_ever_speech_after_a_second_and_a_half():
    """Noise with a corner at 80 Hz, as of traffic or a fan."""
    rumble = np.convolve(white_noise(12.0, -40.0), 0.97 ** np.arange(300), mode="same")

    assert open_frames(rumble)[150:].mean() < 0.05


@pytest.mark.parametrize("gain_db", [0.0, -30.0])
def test_speech_is_speech_also_when_quiet(clip, gain_db):
    """Loud frames: within 25 dB of the loudest twentieth."""
    is_open, levels = open_frames(clip * 10 ** (gain_db / 20)), levels_db(clip)
    loud = levels > np.percentile(levels, 95) - 25

    assert is_open[loud].mean() > 0.97


def test_speech_in_noise_20_db_weaker_is_speech(clip):
    noise = white_noise(len(clip) / 16_000 + 3.0, -40.0)
    speech_db = 10 * np.log10(np.mean(clip**2))
    noise[-len(clip) :] += clip * 10 ** ((-20 - speech_db) / 20)
    is_open = open_frames(noise)
    levels = levels_db(clip)
    loud = levels > np.percentile(levels, 95) - 10

    assert not is_open[150:300].any()
    assert is_open[-len(levels) :][loud].mean() > 0.9


def test_a_click_does_not_open_the_gate():
    samples = np.zeros(16_000)
    samples[8_000:8_200] = white_noise(0.0125, -10.0)

    assert not open_frames(samples).any()


def test_a_stop_closure_does_not_close_the_gate_and_a_pause_does():
    loud, quiet = -20.0, -80.0
    gate = VoiceActivityDetector()

    def hear(level, duration_s):
        return [gate.push(level) for _ in range(round(duration_s * FRAMES_PER_S))]

    hear(quiet, 1.5)
    assert hear(loud, 0.2) == [False] * 2 + [True] * 18
    assert all(hear(quiet, 0.12))
    assert all(hear(loud, 0.2))
    assert hear(quiet, 0.3) == [True] * 14 + [False] * 16
