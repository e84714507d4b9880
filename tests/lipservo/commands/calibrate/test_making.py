"""What becomes of a fresh calibration by its grade."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from calibration.calibration import CalibrationError
from calibration.files.calibration_file import load_calibration
from calibration.grade import Grade
from lipservo.calibrating.measured_calibration import CalibrationResult
from lipservo.commands.calibrate.making import finish, load_setup, resumable_poses, save_so_far
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


def result_of(grade):
    calibration = load_calibration(CONFIG / "face_sim.calibration.yaml")
    fit = SimpleNamespace(face=SimpleNamespace(left_out_rms_mm=0.5))
    return CalibrationResult(replace(calibration, grade=grade), fit)


def test_a_calibration_is_saved_before_it_is_graded_and_the_file_before_it_stays_the_previous(
    setup, tmp_path
):
    output = tmp_path / "face.calibration.yaml"
    output.write_bytes((CONFIG / "face_lips.calibration.yaml").read_bytes())
    earlier = output.read_bytes()

    save_so_far(setup, result_of(None), output)
    assert load_calibration(output).grade is None
    save_so_far(setup, result_of(GOOD), output)
    finished(setup, GOOD, output)

    assert load_calibration(output).grade == GOOD
    assert output.with_name("face.calibration.yaml.previous").read_bytes() == earlier


def test_a_grade_that_is_too_bad_brings_back_the_file_before_the_ungraded_one(setup, tmp_path):
    output = tmp_path / "face.calibration.yaml"
    output.write_bytes((CONFIG / "face_lips.calibration.yaml").read_bytes())
    earlier = output.read_bytes()
    save_so_far(setup, result_of(None), output)
    save_so_far(setup, result_of(BAD), output)
    assert load_calibration(output).grade is None

    with pytest.raises(UserError, match="is not written: only 30% of an opening"):
        finished(setup, BAD, output)

    assert output.read_bytes() == earlier


def test_a_run_that_is_cut_short_after_its_grade_and_repeated_keeps_the_file_before_both(
    setup, tmp_path
):
    output = tmp_path / "face.calibration.yaml"
    output.write_bytes((CONFIG / "face_lips.calibration.yaml").read_bytes())
    earlier = output.read_bytes()
    for grade in (None, GOOD, None):
        save_so_far(setup, result_of(grade), output)
    assert load_calibration(output).grade == GOOD
    finished(setup, GOOD, output)
    assert output.with_name("face.calibration.yaml.previous").read_bytes() == earlier


def test_a_grade_that_is_too_bad_brings_back_no_file_that_was_deleted_before(setup, tmp_path):
    output = tmp_path / "face.calibration.yaml"
    ancient = (CONFIG / "face_lips.calibration.yaml").read_bytes()
    output.with_name("face.calibration.yaml.previous").write_bytes(ancient)
    save_so_far(setup, result_of(None), output)
    with pytest.raises(UserError, match="is not written"):
        finished(setup, BAD, output)
    assert not output.exists()
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [ancient]


def test_a_bad_grade_that_was_accepted_stays_when_the_same_command_no_longer_accepts(
    setup, tmp_path
):
    output = tmp_path / "face.calibration.yaml"
    finished(replace(setup, accept=True), BAD, output)
    with pytest.raises(UserError, match="is not written"):
        finished(setup, BAD, output)
    assert load_calibration(output).grade == BAD


def test_kept_poses_are_put_aside_when_all_is_done_and_named_when_it_is_refused(tmp_path):
    output = tmp_path / "face.calibration.yaml"
    kept = output.with_name("face.calibration.yaml.poses")
    kept.write_text("a pose")

    def refused():
        with resumable_poses(output, None):
            raise CalibrationError("'jaw' is reversed")

    with pytest.raises(
        CalibrationError, match=r"reversed; the poses are kept in .*poses: run the same"
    ):
        refused()
    assert kept.exists()

    with resumable_poses(output, None) as again:
        assert again == kept
    assert [path.name for path in tmp_path.iterdir()] == ["face.calibration.yaml.poses.previous"]

    own = tmp_path / "mine.jsonl"
    own.write_text("a pose")
    with resumable_poses(output, own) as again:
        assert again == own
    assert own.exists()
