"""Performances: kept and read back, and refused in one line where they cannot be played."""

import json
import os
from dataclasses import replace

import numpy as np
import pytest
from small_model import small_model

from lipsync.offline import performance as performance_file
from lipsync.offline.performance import (
    Performance,
    PerformanceError,
    PerformedSound,
    performed_sound,
    read_performance,
    sound_file,
    write_performance,
)
from lipsync.phonemes import PhonemeEvent

MODEL = small_model()


@pytest.fixture
def sound(tmp_path):
    path = tmp_path / "line.wav"
    path.write_bytes(b"RIFF and so on")
    return path


@pytest.fixture
def path(tmp_path):
    return tmp_path / "line.perf"


@pytest.fixture
def plain(sound):
    return performance(performed_sound(sound, included=True))


def performance(sound):
    """Return a performance of two faces, 10 ms apart, in AA and silence, with this sound."""
    return Performance(
        MODEL.checksum,
        np.arange(10, dtype=np.float32).reshape(2, 5),
        (PhonemeEvent("AA", 0.0, 0.5), PhonemeEvent("SIL", 0.5, 1.0)),
        sound,
        "heard",
    )


def sound_of(path):
    with sound_file(read_performance(path).sound, path) as file:
        return file.read_bytes()


def test_what_is_written_is_read_with_its_sound(sound, path, plain):
    write_performance(plain, path)
    sound.unlink()

    found = read_performance(path)

    assert found.phonemes == plain.phonemes
    assert found.coefficients.tolist() == plain.coefficients.tolist()
    assert sound_of(path) == b"RIFF and so on"
    assert found.duration_s == pytest.approx(0.01)
    found.check_face(MODEL, str(path))


def test_head_and_eyes_are_read_back_but_not_what_a_later_lipservo_stores(path, plain):
    moved = {"neck_yaw_deg": np.float32([1.5, -2.5]), "brow": np.float32([0.0, 0.25])}
    later = {**moved, "ears": np.float32([1.0, 1.0])}
    write_performance(replace(plain, expression=later), path)

    found = read_performance(path).expression
    assert {name: values.tolist() for name, values in found.items()} == {
        name: values.tolist() for name, values in moved.items()
    }
    write_performance(plain, path)
    assert read_performance(path).expression == {}


def test_a_pipe_or_a_folder_in_its_place_is_refused_at_once(tmp_path):
    pipe = tmp_path / "pipe.perf"
    os.mkfifo(pipe)
    for path in (pipe, tmp_path):
        with pytest.raises(PerformanceError, match="not a file"):
            read_performance(path)


def test_what_would_be_refused_is_not_written(path, plain, monkeypatch):
    with pytest.raises(PerformanceError, match="longer than 10 minutes"):
        write_performance(replace(plain, coefficients=np.zeros((60_002, 5), np.float32)), path)
    monkeypatch.setattr(performance_file, "_MOST_SOUND_BYTES", 10)
    with pytest.raises(PerformanceError, match="convert it to FLAC, or render with --reference"):
        write_performance(plain, path)
    assert not path.exists()


def test_a_sound_that_is_named_is_found_beside_and_known_again(sound, path):
    write_performance(performance(performed_sound(sound, included=False)), path)

    assert sound_of(path) == b"RIFF and so on"
    sound.write_bytes(b"another")
    with pytest.raises(PerformanceError, match="is not the one it was rendered from"):
        sound_of(path)
    sound.unlink()
    with pytest.raises(PerformanceError, match="cannot be read"):
        sound_of(path)


def test_another_face_is_refused(plain):
    other = Performance("0" * 16, plain.coefficients, plain.phonemes, plain.sound, plain.method)

    with pytest.raises(PerformanceError, match="rendered for face model 0000000000000000"):
        other.check_face(MODEL, "line.perf")


def rewritten(path, **changes):
    """Rewrite the file in `path` with other arrays, or other entries of its header, by name."""
    with np.load(path) as archive:
        arrays = dict(archive)
    about = json.loads(arrays["about"].tobytes())
    for key, value in changes.items():
        (arrays if key in arrays else about)[key] = value
    arrays["about"] = np.frombuffer(json.dumps(about).encode(), dtype=np.uint8)
    with path.open("wb") as file:
        np.savez(file, **arrays)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"version": 2}, "performance version 2"),
        ({"kind": "else"}, "not a performance"),
        ({"phonemes": [["XX", 0.0, 1.0]]}, "phoneme 'XX'"),
        ({"phonemes": [["AA", 1.0, 0.5]]}, "from 1.0 to 0.5 s"),
        ({"coefficients": np.full((2, 5), np.nan)}, "not finite"),
        ({"expression": ["brow"]}, "damaged"),
        ({"sound": {"name": "../x.wav", "sha256": "0", "included": False}}, "sound name"),
    ],
)
def test_what_cannot_be_played_is_told_in_one_line(path, changes, message):
    write_performance(performance(PerformedSound("line.wav", "0", None)), path)
    rewritten(path, **changes)

    with pytest.raises(PerformanceError) as raised:
        read_performance(path)

    assert message in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04", b"no zip at all", b"\x93NUMPY\x01\x00"])
def test_a_damaged_file_is_refused(path, content):
    path.write_bytes(content)

    with pytest.raises(PerformanceError, match="damaged or not a performance") as raised:
        read_performance(path)
    assert "pickle" not in str(raised.value)
