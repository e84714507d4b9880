"""Sound files as people have them: channels that cancel, floats at another scale, no size, GSM."""

import struct

import numpy as np
import pytest
import soundfile

from lipsync.audio.file import FileSource, checked_sound, read_sound, read_speech
from lipsync.audio.source import SoundError

RATE_HZ = 16_000


def voice(seconds=1.0, level=0.3):
    """A vowel-like sound: harmonics of 120 Hz."""
    time_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    return level * sum(np.sin(2 * np.pi * 120 * n * time_s) / n for n in range(1, 6)) / 2


def written(tmp_path, samples, subtype="PCM_16", name="a.wav", rate_hz=RATE_HZ):
    soundfile.write(tmp_path / name, samples, rate_hz, subtype=subtype)
    return tmp_path / name


def heard(path, **choice):
    with FileSource(path, **choice) as source:
        blocks = source.blocks(60.0)
    return np.concatenate([each.samples for each in blocks])


def test_channels_that_cancel_are_told_and_one_is_used(tmp_path):
    samples = voice()
    path = written(tmp_path, np.stack([samples, -samples], axis=1))

    checked = checked_sound(path)
    assert checked.warning == f"{path}: its channels cancel each other; channel 1 alone is used"
    assert read_sound(path)[0] == pytest.approx(samples, abs=1e-4)
    assert heard(path) == pytest.approx(samples, abs=1e-4)


def test_channels_that_do_not_cancel_are_averaged_as_ever(tmp_path):
    left, right = voice(), voice(level=0.1)
    path = written(tmp_path, np.stack([left, right], axis=1))

    assert checked_sound(path).warning == ""
    assert read_sound(path)[0] == pytest.approx((left + right) / 2, abs=1e-4)
    assert heard(path) == pytest.approx((left + right) / 2, abs=1e-4)


@pytest.mark.parametrize("bits", [16, 24, 32])
def test_floats_that_are_whole_numbers_are_scaled_and_told(tmp_path, bits):
    path = written(tmp_path, voice() * 2.0 ** (bits - 1), "FLOAT")

    assert f"read as whole numbers of {bits} bits" in checked_sound(path).warning
    assert read_sound(path)[0] == pytest.approx(voice(), abs=1e-4)


def test_overdriven_floats_are_clipped_as_ever(tmp_path):
    path = written(tmp_path, 4 * voice(), "FLOAT")

    assert checked_sound(path).warning == ""
    assert read_sound(path)[0] == pytest.approx(np.clip(4 * voice(), -1, 1), abs=1e-6)


def test_a_very_quiet_file_is_told_with_its_level(tmp_path):
    quiet = voice(level=1e-3)
    level_dbfs = 10 * np.log10((quiet**2).mean())
    path = written(tmp_path, quiet, "FLOAT")

    assert f"very quiet, {level_dbfs:.0f} dBFS" in checked_sound(path).warning
    assert checked_sound(written(tmp_path, voice(level=0.05), "FLOAT")).warning == ""


@pytest.mark.parametrize("size", [0, 0xFFFF_FFFF])
def test_a_size_that_was_never_written_is_read_to_the_end_and_is_no_warning(tmp_path, caplog, size):
    """As ffmpeg writes it into a pipe."""
    path = written(tmp_path, voice())
    content = bytearray(path.read_bytes())
    at = content.find(b"data") + 4
    content[at : at + 4] = content[4:8] = struct.pack("<I", size)
    path.write_bytes(content)

    assert (checked_sound(path).duration_s, checked_sound(path).warning) == (1.0, "")
    assert read_sound(path)[0] == pytest.approx(voice(), abs=1e-4)
    assert heard(path) == pytest.approx(voice(), abs=1e-4)
    assert caplog.messages == []


@pytest.mark.parametrize("subtype", ["GSM610", "G721_32", "IMA_ADPCM", "ULAW"])
def test_compressed_wav_files_of_telephones_are_heard(tmp_path, subtype):
    if subtype not in soundfile.available_subtypes("WAV"):
        pytest.skip(f"this libsndfile writes no {subtype}")
    path = written(tmp_path, voice()[::2], subtype, rate_hz=8_000)

    assert abs(len(heard(path)) / RATE_HZ - 1.0) < 0.1
    assert np.corrcoef(heard(path)[:RATE_HZ], voice()[: len(heard(path))][:RATE_HZ])[0, 1] > 0.8


def test_the_channel_that_is_named_is_heard(tmp_path):
    left, right = voice(), voice(level=0.1)
    path = written(tmp_path, np.stack([left, right], axis=1))

    for channel, expected in (("left", left), ("2", right), ("mix", (left + right) / 2)):
        assert read_speech(path, channel) == pytest.approx(expected, abs=1e-4)
        assert heard(path, channel=channel) == pytest.approx(expected, abs=1e-4)


def test_a_channel_that_is_not_there_is_refused(tmp_path):
    path = written(tmp_path, voice())

    with pytest.raises(SoundError, match="has 1 channel, not right; leave --channel out, or"):
        checked_sound(path, "right")


def test_a_silent_channel_is_refused_as_a_silent_file_is(tmp_path):
    path = written(tmp_path, np.stack([voice(), 0 * voice()], axis=1))

    with pytest.raises(SoundError, match="only digital silence"):
        checked_sound(path, "right")


@pytest.mark.parametrize("subtype", ["OPUS", "VORBIS"])
def test_an_ogg_file_without_its_last_page_is_told(tmp_path, subtype):
    path = written(tmp_path, voice(12.0), subtype, "a.ogg")
    assert checked_sound(path).warning == ""
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 6 // 10])

    checked = checked_sound(path)
    assert "cut short: its end is missing" in checked.warning
    assert 1.0 < checked.duration_s < 11.0


@pytest.mark.parametrize("seconds", [3.0, 90.0])
def test_a_cut_mp3_is_told_and_its_decoder_says_nothing(tmp_path, capfd, seconds):
    path = written(tmp_path, voice(seconds), "MPEG_LAYER_III", "a.mp3")
    content = path.read_bytes()
    assert checked_sound(path).warning == ""
    path.write_bytes(content[: len(content) * 6 // 10])

    checked = checked_sound(path)
    assert f"promises {seconds:.2f} s" in checked.warning
    assert checked.duration_s == pytest.approx(0.6 * seconds, rel=0.15)
    path.write_bytes(content[:1500] + bytes(200) + content[1700:])
    assert checked_sound(path).duration_s == pytest.approx(seconds, abs=0.3)
    assert capfd.readouterr().err == ""
