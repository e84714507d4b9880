import math

import numpy as np
import pytest
import soundfile
from hypothesis import given, settings
from hypothesis import strategies as st
from lipservo_lab.learning.recognition.noise import band, chords
from speech import CLIP_PATH
from synthetic_voice import SAMPLE_RATE_HZ, harmonics, room, voice

from lipsync.prosody.voice_tracker import VoiceTracker


def frames_of(samples, tracker=None):
    tracker = tracker or VoiceTracker()
    blocks = samples[: len(samples) // 160 * 160].reshape(-1, 160).astype(np.float32)
    return [tracker.feed(block) for block in blocks]


def field(frames, name):
    return np.array([getattr(frame, name) for frame in frames])


def test_level_and_peak_of_a_sine():
    t_s = np.arange(SAMPLE_RATE_HZ) / SAMPLE_RATE_HZ
    last = frames_of(0.5 * np.sin(2.0 * np.pi * 200.0 * t_s))[-1]

    assert last.loudness_db == pytest.approx(20.0 * math.log10(0.5 / math.sqrt(2.0)), abs=0.05)
    assert last.peak == pytest.approx(0.5, abs=0.001)
    assert last.pitch_hz == pytest.approx(200.0, rel=0.002)
    assert last.time_s == pytest.approx(1.0)


def test_tilt_is_the_energy_above_500_hz_over_that_below():
    t_s = np.arange(SAMPLE_RATE_HZ) / SAMPLE_RATE_HZ
    low, high = np.sin(2.0 * np.pi * 240.0 * t_s), np.sin(2.0 * np.pi * 2000.0 * t_s)

    assert frames_of(0.1 * low + 0.05 * high)[-1].tilt_db == pytest.approx(-6.02, abs=0.1)
    assert frames_of(0.02 * low + 0.2 * high)[-1].tilt_db == pytest.approx(20.0, abs=0.2)


def test_an_offset_of_the_microphone_is_not_loud():
    assert frames_of(np.full(8_000, 0.5))[-1].loudness_db < -60.0


def test_a_recorded_sentence_is_speech_and_what_follows_is_not():
    clip = soundfile.read(CLIP_PATH)[0]
    is_speech = field(frames_of(np.concatenate((clip, np.zeros(16_000)))), "is_speech")
    n_clip = len(clip) // 160

    assert is_speech[:n_clip].mean() > 0.6
    assert not is_speech[n_clip + 30 :].any()


@pytest.mark.parametrize("level_db", [-60.0, -40.0, -15.0])
def test_steady_noise_is_not_speech(level_db):
    noise = room(6.0, np.random.default_rng(0), level_db)

    assert not field(frames_of(noise), "is_speech")[150:].any()


def song():
    """Single notes with a breath between: the level alone would let it pass."""
    rng, t = np.random.default_rng(3), np.linspace(0.0, 1.0, 8_000)
    return np.concatenate(
        [
            0.1 * np.sin(np.pi * t) * harmonics(np.full(8_000, 196.0 * 2.0 ** (n / 12.0)))
            for n in rng.choice([0, 2, 4, 5, 7, 9, 11, 12], 40)
        ]
    )


def music(kind, n_samples, seed=0):
    """What the recogniser learned as music."""
    return 0.05 * kind(np.random.default_rng(seed), n_samples)


@pytest.mark.parametrize(
    ("heard", "from_frame", "most"),
    [
        ([0.1 * harmonics(np.full(6 * SAMPLE_RATE_HZ, 220.0))], 130, 0.0),
        ([song()], 300, 0.1),
        ([music(band, 96_000)], 300, 0.2),
        ([music(chords, 160_000, seed) for seed in range(2)], 300, 0.4),
    ],
    ids=["held note", "song", "band", "chords"],
)
def test_music_is_seldom_speech_for_long(heard, from_frame, most):
    shares = [field(frames_of(each), "is_speech")[from_frame:].mean() for each in heard]

    assert np.mean(shares) <= most


def test_speech_after_music_is_heard():
    clip = soundfile.read(CLIP_PATH)[0]
    heard = np.concatenate((music(chords, 80_000), np.zeros(8_000), clip))
    is_speech = field(frames_of(heard), "is_speech")

    assert is_speech[-len(clip) // 160 :].mean() > 0.5


def test_the_baseline_stands_still_in_silence():
    rng = np.random.default_rng(0)
    spoken = voice(8.0, rng)
    once = voice(3.0, rng)
    at_once = frames_of(np.concatenate((spoken, np.zeros(8_000), once)))[-300:]
    later = frames_of(np.concatenate((spoken, np.zeros(160_000), once)))[-300:]

    for name in ("loudness_z", "pitch_z", "tilt_z"):
        assert field(at_once, name) == pytest.approx(field(later, name), abs=1e-6)


def test_the_speaker_s_own_voice_is_zero_on_average_whoever_speaks():
    for pitch_hz, level_db in ((110.0, -40.0), (290.0, -20.0)):
        spoken = voice(20.0, np.random.default_rng(0), pitch_hz=pitch_hz, level_db=level_db)
        frames = [f for f in frames_of(spoken)[1000:] if math.isfinite(f.pitch_hz) and f.is_speech]

        assert abs(field(frames, "pitch_z").mean()) < 0.25
        assert abs(field(frames, "loudness_z").mean()) < 0.25


def test_time_is_counted_or_told():
    tracker = VoiceTracker()

    assert tracker.feed(np.zeros(160, np.float32)).time_s == pytest.approx(0.01)
    assert tracker.feed(np.zeros(160, np.float32), 7.5).time_s == 7.5
    assert tracker.feed(np.zeros(80, np.float32)).time_s == pytest.approx(7.505)
    with pytest.raises(ValueError, match="161"):
        tracker.feed(np.zeros(161, np.float32))


SAMPLES = st.one_of(
    st.floats(width=32),  # NaN and infinity among them
    st.sampled_from([0.0, 1.0, -1.0, 1e-30, 1e30]),
)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.tuples(st.lists(SAMPLES, min_size=1, max_size=6), st.booleans(), st.integers(0, 160)),
        min_size=1,
        max_size=12,
    )
)
def test_whatever_is_heard_stays_within_bounds(pieces):
    tracker = VoiceTracker()
    for values, is_noise, n_samples in pieces:
        block = np.resize(np.array(values, np.float32), n_samples)
        if is_noise:
            block = block * np.random.default_rng(0).uniform(-1, 1, n_samples).astype(np.float32)
        for _ in range(8):
            frame = tracker.feed(block)
            assert 0.0 <= frame.peak <= 1.0
            assert -120.0 <= frame.loudness_db <= 0.1
            assert math.isnan(frame.pitch_hz) or 55.0 < frame.pitch_hz < 520.0
            assert -130.0 < frame.tilt_db < 130.0
            assert max(map(abs, (frame.loudness_z, frame.pitch_z, frame.tilt_z))) <= 4.0
            assert -1.0 <= frame.arousal <= 1.0
