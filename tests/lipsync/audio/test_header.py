"""Sound files that are refused, and what a header says that the file does not hold."""

import os
from pathlib import Path

import numpy as np
import pytest
import soundfile
from speech import cut_short, tone

from lipsync.audio.file import FileSource, read_sound
from lipsync.audio.source import SoundError


def wav(samples, rate_hz=16_000, subtype=None):
    return lambda path: soundfile.write(path, samples, rate_hz, subtype=subtype)


def wav_with(value, *places):
    samples = tone(16_000, 3.0)
    samples[list(places)] = value
    return wav(samples, subtype="FLOAT")


BAD_FILES = [
    (lambda _: None, "no such file"),
    (Path.mkdir, "is a directory"),
    (os.mkfifo, "is a pipe or a device, not a file"),
    (Path.touch, "the file is empty"),
    (lambda path: path.write_text("this is not sound" * 10), "not a sound file"),
    (wav(np.zeros(0)), "has no sound"),
    (wav(np.zeros(48_000), 48_000), "only digital silence"),
    (wav(tone(16_000, 0.02)), "20.0 ms of sound is too short; at least 25 ms"),
    (wav(tone(16_000), 1), "a sample rate of 1 Hz is not possible here (4000 to 192000 Hz are)"),
    (wav(tone(16_000), 1_000_000), "a sample rate of 1000000 Hz is not possible here"),
    (wav(np.tile(tone(16_000)[:, None], 33)), "33 channels are not possible here (up to 32 are)"),
    (wav_with(np.nan, 8_000, 40_000), "2 samples are not numbers (NaN or infinite), the first at "
     "0.5000 s"),
    (wav_with(np.inf, 16), "1 samples are not numbers (NaN or infinite), the first at 0.0010 s"),
]  # fmt: skip


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


def test_a_header_that_does_not_say_how_long_a_long_file_is_is_refused(tmp_path):
    path = tmp_path / "streamed.flac"
    soundfile.write(path, np.tile(tone(8_000, 1.0), 61), 8_000)
    content = bytearray(path.read_bytes())
    content[21] &= 0xF0  # STREAMINFO: 36 bits that count the samples; 0 is "unknown"
    content[22:26] = bytes(4)
    path.write_bytes(content)

    with pytest.raises(SoundError, match="its header gives no length"):
        FileSource(path)
