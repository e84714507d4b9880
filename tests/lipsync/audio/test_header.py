"""Sound files that are refused, and what a header says that the file does not hold."""

import os

import numpy as np
import pytest
import soundfile
from speech import cut_short, tone

from lipsync.audio.file import FileSource, read_sound
from lipsync.audio.source import SoundError


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


def make_pipe(path):
    os.mkfifo(path)


def write_one_hertz(path):
    soundfile.write(path, tone(16_000), 1)


def write_a_megahertz(path):
    soundfile.write(path, tone(16_000), 1_000_000)


def write_33_channels(path):
    soundfile.write(path, np.tile(tone(16_000)[:, None], 33), 16_000)


BAD_FILES = [
    (lambda _: None, "no such file"),
    (make_directory, "is a directory"),
    (write_nothing, "the file is empty"),
    (write_text, "not a sound file"),
    (write_no_samples, "has no sound"),
    (write_zeros, "only digital silence"),
    (write_too_little, "20.0 ms of sound is too short; at least 25 ms"),
    (write_not_a_number, "2 samples are not numbers (NaN or infinite), the first at 0.5000 s"),
    (make_pipe, "is a pipe or a device, not a file"),
    (write_one_hertz, "a sample rate of 1 Hz is not possible here (4000 to 192000 Hz are)"),
    (write_a_megahertz, "a sample rate of 1000000 Hz is not possible here"),
    (write_33_channels, "33 channels are not possible here (up to 32 are)"),
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


@pytest.mark.parametrize("container", ["WAV", "AIFF"])
@pytest.mark.parametrize("read", [FileSource, read_sound])
def test_a_file_cut_short_is_read_as_far_as_it_goes_and_logged_once(
    tmp_path, caplog, container, read
):
    path = tmp_path / "cut.sound"
    soundfile.write(path, tone(16_000, 4.0), 16_000, format=container)
    cut_short(path, 0.35)

    read(path)

    assert FileSource(path).duration_s == pytest.approx(1.4, abs=0.01)
    (line,) = caplog.messages
    assert line.startswith(f"{path}: cut short: its header promises 4.00 s, the file holds 1.40")


def test_nothing_is_logged_of_a_whole_file_or_of_a_size_that_was_not_known(tmp_path, caplog):
    path = tmp_path / "piped.wav"
    soundfile.write(path, tone(16_000), 16_000)
    whole = bytearray(path.read_bytes())
    FileSource(path)
    whole[4:8] = whole[40:44] = b"\xff" * 4  # as ffmpeg writes it into a pipe
    path.write_bytes(whole)

    assert FileSource(path).duration_s == 0.5
    assert caplog.messages == []


def test_a_header_that_does_not_say_how_long_a_long_file_is_is_refused(tmp_path):
    path = tmp_path / "streamed.flac"
    soundfile.write(path, np.tile(tone(8_000, 1.0), 61), 8_000)
    content = bytearray(path.read_bytes())
    content[21] &= 0xF0  # STREAMINFO: 36 bits that count the samples; 0 is "unknown"
    content[22:26] = bytes(4)
    path.write_bytes(content)

    with pytest.raises(SoundError, match="its header gives no length"):
        FileSource(path)
