"""Other voices say the same at the same time."""

import numpy as np
import pytest
import soundfile
from lipservo_lab.learning.recognition.augmentation import (
    LabelledSamples,
    shouted,
    warped,
    whispered,
)
from lipservo_lab.learning.recognition.training_data import disturbed_copy, surroundings
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


def test_every_fourth_copy_has_other_voices_and_no_noise():
    """What was silent stays silent there; in most other copies it is heard through something."""
    samples = np.zeros(2 * RATE_HZ, np.float32)
    samples[:RATE_HZ] = 0.3 * np.sin(2.0 * np.pi * 220.0 / RATE_HZ * np.arange(RATE_HZ))
    recordings = [LabelledSamples(samples, np.zeros(200, np.int64))] * 12
    around = surroundings(recordings)

    def silent(copy: int) -> list[bool]:
        spoken = [
            each.samples[: samples.size]
            for each in disturbed_copy(recordings, around, copy, seed=0)
            if len(each.samples) != 3 * RATE_HZ
        ]
        return [float(np.abs(each[-8_000:]).max()) < 1e-3 for each in spoken]

    assert all(silent(0))
    assert np.mean(silent(4)) > 0.7, "whispered noise alone may fill it"
    assert np.mean(silent(1)) < 0.5
