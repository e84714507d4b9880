"""Sounds that are learned as silence."""

import numpy as np
import pytest
import soundfile
from lipservo_lab.learning.recognition import augmentation, noise, nonspeech_sounds
from lipservo_lab.learning.recognition.augmentation import LabelledSamples, Surroundings
from lipservo_lab.learning.recognition.noise import FoundSoundsError, found, read_found_sounds
from lipservo_lab.learning.recognition.nonspeech_sounds import laughter_of

from lipsync.phonemes import PHONEMES, SILENCE

KINDS = [
    nonspeech_sounds.impulses,
    nonspeech_sounds.cough,
    nonspeech_sounds.laughter,
    nonspeech_sounds.hum,
    nonspeech_sounds.motors,
    nonspeech_sounds.servos,
    nonspeech_sounds.any_sound,
]


@pytest.mark.parametrize("make", KINDS)
def test_every_kind_has_unit_power_and_repeats_with_its_seed(make):
    for seed in range(3):
        sound = make(np.random.default_rng(seed), 20_000)
        assert sound.shape == (20_000,)
        assert sound.dtype == np.float32
        assert np.mean(np.square(sound, dtype=np.float64)) == pytest.approx(1.0, rel=1e-3)
        assert np.array_equal(sound, make(np.random.default_rng(seed), 20_000))
    other = make(np.random.default_rng(7), 20_000)
    assert not np.array_equal(sound, other)


def test_a_hum_stands_on_the_mains():
    sound = nonspeech_sounds.hum(np.random.default_rng(1), 64_000)
    spectrum = np.abs(np.fft.rfft(sound * np.hanning(64_000)))
    peaks_hz = np.sort(np.argsort(spectrum)[-3:]) * 16_000 / 64_000
    base_hz = min((50.0, 60.0), key=lambda hz: abs(peaks_hz[0] / hz - round(peaks_hz[0] / hz)))
    assert peaks_hz / base_hz == pytest.approx(np.round(peaks_hz / base_hz), rel=0.006)


def test_found_sounds_are_read_repeated_with_pauses_and_cut(tmp_path):
    soundfile.write(tmp_path / "short.wav", np.full(1_600, 0.5), 16_000)
    (tmp_path / "notes.txt").write_text("no sound")
    told = []
    sounds = read_found_sounds(tmp_path, told.append)
    assert [len(sound) for sound in sounds] == [1_600]
    assert "notes.txt" in told[0]
    part = found(sounds)(np.random.default_rng(0), 64_000)
    assert np.mean(np.square(part)) == pytest.approx(1.0, rel=1e-3)
    assert 0 < np.count_nonzero(part == 0.0) < 64_000
    long = found([np.arange(1, 50_001, dtype=np.float32)])(np.random.default_rng(0), 1_000)
    assert np.all(np.diff(long) > 0)


@pytest.mark.parametrize("is_there", [False, True])
def test_a_folder_without_sounds_is_refused(tmp_path, is_there):
    folder = tmp_path / "sounds"
    if is_there:
        folder.mkdir()
    with pytest.raises(FoundSoundsError, match=r"no such folder|holds no sound file"):
        read_found_sounds(folder)


def test_what_surrounds_a_voice_moves_no_label():
    """A voice of clicks at known frames: wherever it lands, its labels are with it."""
    silence, aa = PHONEMES.index(SILENCE), PHONEMES.index("AA")
    samples = 1e-4 * np.random.default_rng(0).standard_normal(48_000).astype(np.float32)
    labels = np.full(300, silence)
    labels[100:160] = aa
    samples[16_000:25_600] += 0.3 * np.sin(np.arange(9_600) / 3).astype(np.float32)
    clean = LabelledSamples(samples, labels)
    quiet = noise.babble([samples])
    around = Surroundings(quiet, quiet, laughter_of([(samples, labels)]))
    for seed in range(12):
        changed = augmentation.augment_heavily(np.random.default_rng(seed), clean, around)
        assert len(changed.labels) <= len(changed.samples) // 160 + 1
        assert np.abs(changed.samples).max() <= 1.0
        share = np.mean(changed.labels == aa) * len(changed.labels)
        assert 60 / 1.13 <= share <= 60 / 0.87
