import math
import struct
from pathlib import Path

import numpy as np
import pytest
import soundfile
from speech import CLIP_PATH, cut_short, tone

from lipsync.audio.file import FileSource, checked_sound, played_chunks, read_sound
from lipsync.audio.source import AudioSource, SilenceAfter, SilentSource
from lipsync.audio_block import samples_before


def all_samples(source: AudioSource) -> np.ndarray:
    return np.concatenate([block.samples for block in source.blocks(math.inf)])


@pytest.mark.parametrize(
    ("name", "rate_hz", "subtype", "tolerance"),
    [
        ("8bit.wav", 16_000, "PCM_U8", 0.01),
        ("24bit.wav", 44_100, "PCM_24", 0.001),
        ("float.wav", 48_000, "FLOAT", 0.001),
        ("studio.flac", 192_000, "PCM_24", 0.001),
        ("telephone.wav", 8_000, "ULAW", 0.03),
        ("odd.wav", 22_050, "PCM_16", 0.001),
        ("music.ogg", 44_100, "VORBIS", 0.05),
        ("call.opus", 48_000, "OPUS", 0.05),
    ],
)
def test_a_tone_in_any_format_comes_out_as_the_same_tone_at_16_khz(
    tmp_path, name, rate_hz, subtype, tolerance
):
    path = tmp_path / name
    container = "OGG" if name.endswith("opus") else None
    soundfile.write(path, tone(rate_hz), rate_hz, subtype=subtype, format=container)

    samples = all_samples(FileSource(path))

    assert len(samples) == 8_000
    middle = slice(800, 7_200)  # the ends ring where the file does not go on
    np.testing.assert_allclose(samples[middle], tone(16_000)[middle], atol=tolerance)


@pytest.mark.parametrize("n_samples", [801, 12_345, 44_099, 96_001])
@pytest.mark.parametrize("rate_hz", [11_025, 44_100, 48_000, 96_000])
def test_the_declared_duration_is_where_the_last_block_ends(tmp_path, rate_hz, n_samples):
    path = tmp_path / "sound.wav"
    soundfile.write(path, tone(rate_hz, max(n_samples / rate_hz, 0.026)), rate_hz)
    source = FileSource(path)

    assert source.blocks(math.inf)[-1].end_s == pytest.approx(source.duration_s, abs=1e-9)


def test_reading_keeps_the_files_own_rate(tmp_path):
    soundfile.write(tmp_path / "cd.wav", tone(44_100, 1.5), 44_100)

    samples, sample_rate_hz = read_sound(tmp_path / "cd.wav")

    assert (samples.shape, samples.dtype, sample_rate_hz) == ((66_150,), np.float32, 44_100)


def test_blocks_are_10_ms_the_last_one_shorter_and_then_none(tmp_path):
    soundfile.write(tmp_path / "x.wav", tone(16_000, 0.035), 16_000)
    source = FileSource(tmp_path / "x.wav")

    assert [b.start_s for b in source.blocks(0.0199)] == [0.0]
    assert [b.start_s for b in source.blocks(0.03)] == [0.01, 0.02]
    assert source.blocks(0.0349) == []
    assert [len(b.samples) for b in source.blocks(0.04)] == [80]
    assert source.blocks(1.0) == []


def test_asking_in_ticks_or_at_once_gives_the_same_sound(tmp_path):
    soundfile.write(tmp_path / "x.wav", tone(44_100, 2.5), 44_100)
    ticked = FileSource(tmp_path / "x.wav")

    blocks = [block for n in range(1, 300) for block in ticked.blocks(n * 0.01)]

    assert [b.start_s for b in blocks] == [n / 100 for n in range(250)]
    np.testing.assert_array_equal(
        np.concatenate([b.samples for b in blocks]), all_samples(FileSource(tmp_path / "x.wav"))
    )


def test_a_rounded_tick_time_still_contains_its_last_sample():
    assert 29 * 0.01 < 0.29000000000000004  # the trap: 0.29 s is 4640 samples
    assert [samples_before(n * 0.01) for n in range(10_000)] == [160 * n for n in range(10_000)]


def bytes_read() -> int:
    """By this process so far, from anywhere."""
    counts = Path("/proc/self/io").read_text().split()
    return int(counts[counts.index("rchar:") + 1])


@pytest.mark.skipif(not Path("/proc/self/io").exists(), reason="needs /proc/self/io (Linux)")
def test_the_first_block_of_two_gigabytes_comes_without_reading_them(tmp_path):
    path = tmp_path / "long.wav"
    n_bytes = 2_000_000_000  # of silence, in a file that takes no room on the disk
    with path.open("wb") as file:
        file.write(b"RIFF" + struct.pack("<I", n_bytes + 36) + b"WAVEfmt ")
        file.write(struct.pack("<IHHIIHH", 16, 1, 1, 16_000, 32_000, 2, 16))
        file.write(b"data" + struct.pack("<I", n_bytes))
        file.truncate(n_bytes + 44)
    before = bytes_read()

    source = FileSource(path)
    first = source.blocks(0.01)
    late = FileSource(path, start_s=50_000.0).blocks(50_000.015)

    assert (first[0].start_s, late[0].start_s) == (0.0, 50_000.0)
    assert source.duration_s == 62_500.0
    assert bytes_read() - before < 10_000_000


@pytest.mark.parametrize("start_s", [0.07, 0.754, 1.99, 2.5])
@pytest.mark.parametrize(
    ("name", "rate_hz"),
    [("x.wav", 16_000), ("x.wav", 44_100), ("x.flac", 22_051), ("x.wav", 8_000), ("x.ogg", 48_000)],
)
def test_a_file_taken_up_in_the_middle_goes_on_as_if_it_had_begun(tmp_path, name, rate_hz, start_s):
    noise = 0.3 * np.random.default_rng(0).standard_normal(round(2.7 * rate_hz))
    soundfile.write(tmp_path / name, np.clip(noise, -1, 1), rate_hz)
    whole = FileSource(tmp_path / name).blocks(math.inf)

    taken_up = FileSource(tmp_path / name, start_s=start_s).blocks(math.inf)

    expected = whole[math.floor(start_s * 100 + 1e-6) :]
    assert [b.start_s for b in taken_up] == [b.start_s for b in expected]
    for block, undisturbed in zip(taken_up, expected, strict=True):
        np.testing.assert_allclose(block.samples, undisturbed.samples, atol=1e-5)


def test_a_file_taken_up_after_its_end_is_silence_from_there_on(tmp_path):
    soundfile.write(tmp_path / "x.wav", tone(16_000), 16_000)
    source = SilenceAfter(FileSource(tmp_path / "x.wav", start_s=3_600.0), start_s=3_600.0)

    blocks = source.blocks(3_600.1)

    assert [round(b.start_s, 6) for b in blocks[:2]] == [3_600.0, 3_600.01]
    assert not np.any([b.samples for b in blocks])


def test_what_is_no_number_after_the_first_minute_is_silence_and_logged_at_the_end(
    tmp_path, caplog
):
    path = tmp_path / "long.wav"
    samples = np.tile(tone(4_000, 1.0), 63)
    samples[61 * 4_000 : 61 * 4_000 + 400] = np.nan
    soundfile.write(path, samples, 4_000, subtype="FLOAT")

    with FileSource(path, start_s=60.0) as source:
        heard = all_samples(source)

    assert len(heard) == 3 * 16_000
    assert np.isfinite(heard).all()
    assert np.abs(heard[16_300:17_300]).max() < 0.1 < np.abs(heard[18_000:]).max()
    assert source.lost_blocks == 10
    assert caplog.messages == [f"{path}: samples that are no numbers; played as silence"]


def test_damage_after_the_first_minute_is_silence_to_the_end_that_was_promised(tmp_path, caplog):
    path = tmp_path / "long.flac"
    noise = np.random.default_rng(0).uniform(-0.5, 0.5, 70 * 4_000)
    soundfile.write(path, noise, 4_000)
    cut_short(path, 0.9)

    with FileSource(path) as source:
        blocks = source.blocks(math.inf)

    assert source.duration_s == 70.0 == pytest.approx(blocks[-1].end_s)
    assert not np.any(blocks[-1].samples)
    assert 600 <= source.lost_blocks <= 900
    assert "damaged after 6" in caplog.messages[0]


def test_silence_goes_on_for_ever_in_blocks_of_10_ms():
    with SilentSource() as source:
        first, second = source.blocks(0.025), source.blocks(3_600.0)

    assert [b.start_s for b in first] == [0.0, 0.01]
    assert len(second) == 359_998
    assert second[-1].end_s == 3_600.0
    assert not np.any(second[0].samples)


def test_a_file_that_is_begun_after_its_end_has_no_sound():
    chunks = played_chunks(CLIP_PATH, checked_sound(CLIP_PATH), 3_600 * 48_000, pytest.fail)
    assert not any(len(chunk) for chunk in chunks)
