"""The command around the measurement; the measurement itself: test_null_sink.py, delay/."""

import json

import pytest
from fake_sound_card import device, install_sound_card
from two_servo_face import FACE
from typer.testing import CliRunner

from lipservo.cli import app
from lipservo.settings.settings import load_face
from lipsync.audio import delay as measurement
from lipsync.audio.delay import Delay


@pytest.fixture
def _measured(monkeypatch):
    """A card whose sound is a quarter of a second late."""
    install_sound_card(monkeypatch)
    found = Delay(median_s=0.25012, spread_s=0.0004, n_found=6, n_played=7)
    monkeypatch.setattr(measurement, "measure_delay", lambda *_: found)


def calibrate(*arguments):
    return CliRunner().invoke(app, ["calibrate", "audio", *map(str, arguments)])


@pytest.mark.usefixtures("_measured")
def test_the_offset_is_written_under_the_name_that_lasts(tmp_path):
    face = tmp_path / "face.yaml"
    face.write_text(FACE)
    done = calibrate("--config", face)
    assert done.exit_code == 0, done.output
    assert done.stdout.splitlines() == [
        "USB speaker: -, heard by USB mic: - (hw:2,0): 6 of 7 clicks",
        "sound leaves it 250.1 ms later than it says, give or take 0.4; it says 0 ms after it was "
        "handed over",
        f"written into {face}",
    ]
    assert load_face(face).sound.output_offset_ms == {"USB speaker: -": 250.1}


@pytest.mark.usefixtures("_measured")
def test_devices_of_the_face_are_taken_unless_others_are_named(tmp_path):
    face = tmp_path / "face.yaml"
    face.write_text(f"{FACE}\nsound: {{output: HDMI, input: array}}\n")
    told = json.loads(calibrate("--config", face, "--json", "--dry-run").stdout)
    assert (told["output"], told["input"], told["stored_in"]) == ("HDMI", "array", None)
    told = json.loads(calibrate("--config", face, "--json", "--output", "0").stdout)
    assert (told["output"], told["input"]) == ("USB speaker: -", "array")
    assert told["stored_in"] == str(face)


@pytest.mark.usefixtures("_measured")
@pytest.mark.parametrize("arguments", [(), ("--config", "face.yaml", "--dry-run")])
def test_what_is_not_written_is_told(tmp_path, monkeypatch, arguments):
    """A shipped face is not ours to change; a dry run changes none."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "face.yaml").write_text(FACE)
    done = calibrate(*arguments)
    assert done.exit_code == 0
    assert '    "USB speaker: -": 250.1\n' in done.stderr
    assert (tmp_path / "face.yaml").read_text() == FACE


def test_without_a_loudspeaker_it_is_refused_in_one_line(monkeypatch):
    install_sound_card(monkeypatch, devices=[device(0, "array", n_inputs=4)])
    done = calibrate()
    assert done.exit_code != 0
    assert "no loudspeaker: plug one in" in str(done.exception)
