"""What becomes of a fresh calibration by its grade."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from calibration.files.calibration_file import load_calibration
from calibration.grade import Grade
from lipservo.calibrating.measured_calibration import CalibrationResult
from lipservo.commands.calibrate.making import finish, load_setup
from lipsync.errors import UserError

CONFIG = Path(__file__).parents[4] / "config"
GOOD = Grade(10, lip_rms_mm=0.5, gap_rms_mm=0.4, closed_gap_mm=0.1, gap_slope=0.95)
BAD = replace(GOOD, gap_slope=0.3)


@pytest.fixture(scope="module")
def setup():
    return load_setup("face_sim", None)


def finished(setup, grade, output):
    calibration = load_calibration(CONFIG / "face_sim.calibration.yaml")
    fit = SimpleNamespace(face=SimpleNamespace(left_out_rms_mm=0.5))
    finish(setup, CalibrationResult(replace(calibration, grade=grade), fit), output, as_json=True)


def test_a_bad_grade_is_refused_and_nothing_is_written(setup, tmp_path):
    output = tmp_path / "face.calibration.yaml"
    with pytest.raises(UserError, match=r"is not written: only 30% of an opening .* --accept"):
        finished(setup, BAD, output)
    assert not list(tmp_path.iterdir())


def test_a_file_that_is_there_outlives_a_bad_grade(setup, tmp_path):
    output = tmp_path / "face.calibration.yaml"
    finished(setup, GOOD, output)
    before = output.read_bytes()
    with pytest.raises(UserError):
        finished(setup, BAD, output)
    assert output.read_bytes() == before


def test_a_bad_grade_is_taken_when_accepted_and_is_kept_in_the_file(setup, tmp_path, capsys):
    output = tmp_path / "face.calibration.yaml"
    finished(replace(setup, accept=True), BAD, output)
    assert load_calibration(output).grade == BAD
    assert json.loads(capsys.readouterr().out)["grade"]["gap_slope"] == 0.3
