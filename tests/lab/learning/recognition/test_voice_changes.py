"""Other voices say the same at the same time."""

import numpy as np
import pytest
import soundfile
from lipservo_lab.learning.recognition.augmentation import shouted, warped, whispered
from speech import CLIP_PATH

RATE_HZ = 16_000


@pytest.fixture(scope="module")
def clip():
    return soundfile.read(CLIP_PATH, dtype="float32")[0][: 4 * RATE_HZ]


def envelope_db(samples):
    frames = samples[: len(samples) // 320 * 320].reshape(-1, 320)
    return 10 * np.log10(np.mean(np.square(frames, dtype=np.float64), axis=1) + 1e-6)


@pytest.mark.parametrize("factor", [0.85, 1.2, 1.4])
def test_a_warped_tone_is_higher_by_the_factor(factor):
    tone = np.sin(2 * np.pi * 400 * np.arange(2 * RATE_HZ) / RATE_HZ).astype(np.float32)
    spectrum = np.abs(np.fft.rfft(warped(tone, factor)[4_000:-4_000]))
    hz = spectrum.argmax() * RATE_HZ / (2 * (len(spectrum) - 1))
    assert hz == pytest.approx(400 * factor, rel=0.01)


@pytest.mark.parametrize(
    "change",
    [
        lambda clip: warped(clip, 0.85),
        lambda clip: warped(clip, 1.4),
        lambda clip: shouted(np.random.default_rng(0), clip),
        lambda clip: whispered(np.random.default_rng(0), clip),
    ],
    ids=["large", "child", "shouted", "whispered"],
)
def test_loud_and_quiet_stay_where_they_were(clip, change):
    changed = change(clip)
    assert changed.dtype == np.float32
    assert len(changed) == len(clip)
    before, after = envelope_db(clip), envelope_db(changed)
    at_its_place = np.corrcoef(before, after)[0, 1]
    assert at_its_place > 0.8
    for shift in (-4, 4):  # 80 ms
        assert np.corrcoef(before, np.roll(after, shift))[0, 1] < at_its_place


def test_a_whisper_has_no_pitch(clip):
    def strongest_period(samples):
        part = samples[RATE_HZ : RATE_HZ + 8_000] - np.mean(samples[RATE_HZ : RATE_HZ + 8_000])
        correlation = np.correlate(part, part, "full")[len(part) - 1 :]
        return correlation[50:200].max() / correlation[0]

    assert strongest_period(clip) > 0.5
    assert strongest_period(whispered(np.random.default_rng(0), clip)) < 0.35
