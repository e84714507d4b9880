import math

import numpy as np
import pytest
import soundfile

from lipsync.audio.block import samples_before
from lipsync.audio.file import FileSource, read_sound
from lipsync.audio.silence import SilentSource
from lipsync.audio.source import AudioSource, SoundError

TONE_HZ = 440.0


def tone(rate_hz: int, duration_s: float = 0.5) -> np.ndarray:
    n_samples = round(duration_s * rate_hz)
    return 0.5 * np.sin(2 * np.pi * TONE_HZ * np.arange(n_samples) / rate_hz)


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


def test_channels_are_averaged(tmp_path):
    left = tone(16_000)
    soundfile.write(tmp_path / "stereo.wav", np.stack([left, 0 * left], axis=1), 16_000)

    np.testing.assert_allclose(
        all_samples(FileSource(tmp_path / "stereo.wav")), left / 2, atol=1e-4
    )


def test_samples_beyond_full_scale_are_clipped(tmp_path):
    soundfile.write(tmp_path / "loud.wav", 4 * tone(16_000), 16_000, subtype="FLOAT")

    samples, _ = read_sound(tmp_path / "loud.wav")

    assert samples.min() == -1.0
    assert samples.max() == 1.0


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


def write_nothing(path):
    path.write_bytes(b"")


def write_text(path):
    path.write_text("this is not sound, whatever its name says" * 10)


def write_no_samples(path):
    soundfile.write(path, np.zeros(0), 16_000)


def write_zeros(path):
    soundfile.write(path, np.zeros(48_000), 48_000)


def write_too_little(path):
    soundfile.write(path, tone(16_000, 0.02), 16_000)


def write_not_a_number(path):
    samples = tone(16_000, 3.0)
    samples[[8_000, 40_000]] = np.nan
    soundfile.write(path, samples, 16_000, subtype="FLOAT")


def write_infinity(path):
    samples = tone(16_000)
    samples[16] = np.inf
    soundfile.write(path, samples, 16_000, subtype="FLOAT")


def make_directory(path):
    path.mkdir()


BAD_FILES = [
    (lambda _: None, "no such file"),
    (make_directory, "is a directory"),
    (write_nothing, "the file is empty"),
    (write_text, "not a sound file"),
    (write_no_samples, "holds no sound"),
    (write_zeros, "only digital silence"),
    (write_too_little, "20.0 ms of sound is too short; at least 25 ms"),
    (write_not_a_number, "2 samples are not numbers (NaN or infinite), the first at 0.5000 s"),
    (write_infinity, "1 samples are not numbers (NaN or infinite), the first at 0.0010 s"),
]


@pytest.mark.parametrize("read", [FileSource, read_sound])
@pytest.mark.parametrize(("write", "complaint"), BAD_FILES)
def test_a_bad_file_is_refused_in_one_line_that_names_it(tmp_path, read, write, complaint):
    path = tmp_path / "bad.wav"
    write(path)

    with pytest.raises(SoundError) as refusal:
        read(path)

    message = str(refusal.value)
    assert message.startswith(f"{path}: ")
    assert complaint in message
    assert "; " in message  # what to do
    assert "\n" not in message


def test_a_file_cut_short_is_read_as_far_as_it_goes(tmp_path):
    soundfile.write(tmp_path / "cut.wav", tone(16_000), 16_000)
    whole = (tmp_path / "cut.wav").read_bytes()
    (tmp_path / "cut.wav").write_bytes(whole[: len(whole) // 2])

    assert FileSource(tmp_path / "cut.wav").duration_s == pytest.approx(0.25, abs=0.01)


def test_silence_goes_on_for_ever_in_blocks_of_10_ms():
    with SilentSource() as source:
        first, second = source.blocks(0.025), source.blocks(3_600.0)

    assert [b.start_s for b in first] == [0.0, 0.01]
    assert len(second) == 359_998
    assert second[-1].end_s == 3_600.0
    assert not np.any(second[0].samples)
