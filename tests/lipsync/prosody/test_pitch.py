import csv
from pathlib import Path

import numpy as np
import pytest
import soundfile
from places import ROOT
from synthetic_voice import SAMPLE_RATE_HZ, harmonics

from lipsync.prosody.voice_tracker import VoiceTracker

CORPUS = ROOT.parent / "shared" / "corpus"
#: The pitch of a frame is that of the middle of 40 ms, two frames ago; 1.5 ms are the filter's.
LATE_S = 0.0415


def pitches_hz(samples):
    tracker = VoiceTracker()
    blocks = samples[: len(samples) // 160 * 160].reshape(-1, 160).astype(np.float32)
    return np.array([tracker.feed(block).pitch_hz for block in blocks])


def glide(middle_hz, duration_s=1.0):
    """Up and down by 2 semitones, (n,) Hz."""
    t_s = np.arange(round(duration_s * SAMPLE_RATE_HZ)) / SAMPLE_RATE_HZ
    return middle_hz * 2.0 ** (2.0 / 12.0 * np.sin(2.0 * np.pi * t_s))


def errors_st(found_hz, true_hz):
    """Of the frames that have a pitch."""
    times_s = 0.01 * (np.arange(len(found_hz)) + 1) - LATE_S
    true_hz = np.interp(times_s, np.arange(len(true_hz)) / SAMPLE_RATE_HZ, true_hz)
    is_voiced = np.isfinite(found_hz) & (times_s > 0.05)
    return 12.0 * np.log2(found_hz[is_voiced] / true_hz[is_voiced])


@pytest.mark.parametrize("pitch_hz", [72.0, 110.0, 200.0, 290.0, 420.0])
@pytest.mark.parametrize("noise_db", [None, 20.0, 10.0])
def test_a_gliding_tone_has_its_pitch_also_in_noise(pitch_hz, noise_db):
    true_hz = glide(pitch_hz)
    rng = np.random.default_rng(0)
    samples = 0.1 * harmonics(true_hz)
    if noise_db is not None:
        samples = samples + rng.normal(0.0, 0.1 * 10.0 ** (-noise_db / 20.0), len(samples))
    found_hz = pitches_hz(samples)
    errors = np.abs(errors_st(found_hz, true_hz))

    assert np.isfinite(found_hz[10:]).mean() > 0.95
    assert np.median(errors) < 0.15
    assert np.mean(errors > 2.0) < 0.02


@pytest.mark.parametrize("pitch_hz", [62.0, 480.0])
def test_the_ends_of_the_range_belong_to_it(pitch_hz):
    found_hz = pitches_hz(0.1 * harmonics(np.full(16_000, pitch_hz)))

    assert found_hz[10:] == pytest.approx(pitch_hz, rel=0.01)


def test_a_voice_without_its_fundamental_keeps_its_pitch():
    """As over a telephone, which begins at 300 Hz."""
    t_s = np.arange(16_000) / SAMPLE_RATE_HZ
    samples = sum(0.05 * np.sin(2.0 * np.pi * 120.0 * k * t_s + k * k) for k in range(3, 12))

    assert np.nanmedian(pitches_hz(samples)) == pytest.approx(120.0, rel=0.01)


def test_noise_and_silence_and_an_offset_have_none():
    rng = np.random.default_rng(1)

    assert np.isfinite(pitches_hz(rng.normal(0.0, 0.1, 80_000))).mean() < 0.01
    assert not np.isfinite(pitches_hz(np.zeros(8_000))).any()
    assert not np.isfinite(pitches_hz(np.full(8_000, 0.5))[10:]).any()


def _of_corpus(paths):
    found = [pitches_hz(soundfile.read(path)[0]) for path in paths]
    return float(np.nanmedian(np.concatenate(found)))


@pytest.mark.skipif(not (CORPUS / "grid_s1").is_dir(), reason="no corpus grid_s1")
def test_the_talker_of_grid_s1_has_the_pitch_of_a_man():
    sounds = sorted((CORPUS / "grid_s1" / "audio").glob("*.flac"))[::220]

    assert 85.0 < _of_corpus(sounds) < 130.0


@pytest.mark.skipif(not (CORPUS / "speechocean762").is_dir(), reason="no corpus speechocean762")
def test_children_speak_higher_than_grown_ups():
    folder = CORPUS / "speechocean762"
    with (folder / "speakers.csv").open() as file:
        speakers = list(csv.DictReader(file))

    def of(group: str, gender: str, n: int = 3) -> list[Path]:
        chosen = [s["speaker"] for s in speakers if (s["group"], s["gender"]) == (group, gender)]
        return [sorted((folder / "audio").glob(f"{name}-*.opus"))[0] for name in chosen[:n]]

    children = _of_corpus(of("child", "m") + of("child", "f"))
    men, women = _of_corpus(of("adult", "m")), _of_corpus(of("adult", "f"))

    assert men < 170.0 < 180.0 < women < children < 330.0
