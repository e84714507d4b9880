"""`bench nonspeech` as it is typed."""

import json

import numpy as np
import pytest
import soundfile
from typer.testing import CliRunner

from lipservo.cli import app

KEYS = {"open_share", "speech_share", "openings_per_min", "widest_mm", "files", "seconds"}


def bench(folder, *options):
    return CliRunner().invoke(app, ["bench", "nonspeech", str(folder), "-q", *options])


def write(path, samples, rate_hz=16_000):
    path.parent.mkdir(parents=True, exist_ok=True)
    soundfile.write(path, samples, rate_hz)


def test_a_folder_of_kinds_has_a_line_for_each_and_names_what_is_no_sound(tmp_path):
    time_s = np.arange(3 * 22_050) / 22_050
    write(tmp_path / "hum" / "a.wav", 0.1 * np.sin(2 * np.pi * 100 * time_s), 22_050)
    write(tmp_path / "hum" / "b.flac", 0.01 * np.sign(np.sin(2 * np.pi * 50 * time_s)), 22_050)
    write(tmp_path / "room.wav", np.random.default_rng(0).uniform(-0.001, 0.001, 16_000))
    (tmp_path / "hum" / "licence.txt").write_text("free")
    (tmp_path / ".hidden").write_text("not looked at")

    done = bench(tmp_path, "--json")

    assert done.exit_code == 0, done.output
    figures = json.loads(done.stdout)
    assert figures.keys() >= KEYS
    assert figures["files"] == 3
    assert figures["seconds"] == pytest.approx(7.0, abs=0.01)
    assert set(figures["folders"]) == {"hum"}
    assert set(figures["folders"]["hum"]) == KEYS
    assert figures["folders"]["hum"]["files"] == 2
    assert set(figures["sounds"]) == {"hum/a.wav", "hum/b.flac", "room.wav"}
    assert figures["open_share"] == figures["folders"]["hum"]["open_share"] == 0.0
    assert len(figures["left_out"]) == 1
    assert "licence.txt: not a sound file" in figures["left_out"][0]


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (lambda _folder: None, "no such folder"),
        (lambda folder: folder.write_bytes(b""), "no such folder"),
        (lambda folder: folder.mkdir(), "holds no file"),
        (
            lambda folder: (folder.mkdir(), (folder / "a.txt").write_text("a")),
            "none of 1 files is sound",
        ),
    ],
)
def test_a_folder_without_sound_is_refused_in_one_line(tmp_path, make, told):
    folder = tmp_path / "sounds"
    make(folder)
    done = bench(folder)
    assert done.exit_code == 1
    assert told in str(done.exception)
    assert "\n" not in str(done.exception)
