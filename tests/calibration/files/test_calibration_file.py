"""The calibration file: whole, readable, refused where it is damaged or another's."""

import dataclasses
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from places import ROOT
from small_model import small_model

from calibration.calibration import (
    Calibration,
    CalibrationError,
    check_calibration,
    check_servo_models,
)
from calibration.files.calibration_file import load_calibration, parse_calibration, save_calibration
from calibration.files.calibration_text import calibration_text
from calibration.fit.learnt_face import fit_calibration
from calibration.grade import Grade, LearntLips, VisemeReach
from calibration.mouth_servos import JointRange
from calibration.simulated.face import POSITIVE_DIRECTIONS
from lipsync.face.model import FaceModel
from lipsync.output_file import OutputError

SERVOS = tuple(POSITIVE_DIRECTIONS)
JOINTS = tuple(JointRange(name, -40.0, 40.0) for name in SERVOS)
FACE = "0123456789abcdef"


@pytest.fixture(scope="module")
def model() -> FaceModel:
    return small_model()


@pytest.fixture(scope="module")
def calibration(model) -> Calibration:
    return fit_calibration(model, JOINTS, FACE)


def test_what_was_measured_is_loaded_as_it_was_and_what_nobody_knows_is_not_written(
    calibration, tmp_path
):
    path = tmp_path / "face.calibration.yaml"
    known = VisemeReach(0.75, 0.5, 0.875, 0.25, 1.0, 0.125, 2, 0.5)
    graded = dataclasses.replace(
        calibration,
        grade=Grade(10, 0.5, 0.25, 0.125, 0.875, 0.5),
        learnt_lips=LearntLips(0.5, 0.25, 1.5, stop=True),
        coverage={"P": known, "AA": VisemeReach(1.0, 0.25)},
        errors=dataclasses.replace(calibration.errors, gap_slope=0.75),
    )
    save_calibration(graded, path)
    loaded = load_calibration(path)
    for part in ("grade", "learnt_lips", "coverage"):
        assert getattr(loaded, part) == getattr(graded, part), part
    assert (loaded.errors.gap_slope, loaded.errors.small_gaps_kept) == (0.75, None)
    text = path.read_text()
    assert "AA: {reachable: 1, off_mm: 0.25}  #" in text
    assert "small_gaps_kept: None" not in text
    with pytest.raises(CalibrationError, match=r"learnt_lips.stop is 1, expected true or false"):
        parse_calibration(text.replace("stop: true", "stop: 1"), "c.yaml")


def test_a_saved_calibration_is_loaded_as_it_was(calibration, tmp_path):
    path = tmp_path / "face.calibration.yaml"
    save_calibration(calibration, path)
    loaded = load_calibration(path)
    for field in ("weights", "rest", "min_deg", "max_deg"):
        assert np.array_equal(getattr(loaded, field), getattr(calibration, field)), field
    assert loaded.servo_names == SERVOS
    assert (loaded.model_checksum, loaded.face_checksum) == (calibration.model_checksum, FACE)
    assert loaded.errors.joint_rms_deg == pytest.approx(calibration.errors.joint_rms_deg, rel=1e-3)
    assert calibration_text(loaded) == path.read_text()
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_servos_of_which_only_some_have_a_model_are_loaded_as_they_were(calibration, tmp_path):
    models = ("XL330-M288", *[""] * (len(SERVOS) - 1))
    origin = dataclasses.replace(calibration.origin, servo_models=models)
    save_calibration(dataclasses.replace(calibration, origin=origin), tmp_path / "c.yaml")
    loaded = load_calibration(tmp_path / "c.yaml")
    assert loaded.origin.servo_models == models
    check_servo_models(loaded, models)
    words = r"calibrated as a servo without a model and is a XC330-M181 in"
    with pytest.raises(CalibrationError, match=words):
        check_servo_models(loaded, (*models[:-1], "XC330-M181"))


def test_many_frames_are_still_a_whole_number_in_the_file(calibration):
    errors = dataclasses.replace(calibration.errors, n_frames=123457)
    many = dataclasses.replace(calibration, errors=errors)
    assert parse_calibration(calibration_text(many), "x").errors.n_frames == 123457


def test_tiny_weights_are_numbers_in_the_file(calibration):
    tiny = dataclasses.replace(calibration, weights=np.full((10, 5), 1e-7))
    assert parse_calibration(calibration_text(tiny), "x").weights[0, 0] == 1e-7


def test_a_file_that_cannot_be_written_is_one_clear_line(calibration, tmp_path):
    with pytest.raises(OutputError, match="cannot be written: there is no folder"):
        save_calibration(calibration, tmp_path / "nowhere" / "c.yaml")


def test_a_failed_write_leaves_the_old_file(calibration, tmp_path):
    path = tmp_path / "c.yaml"
    path.write_text("old")
    (tmp_path / "c.yaml.partial").mkdir()
    with pytest.raises(OutputError, match="cannot be written"):
        save_calibration(calibration, path)
    assert path.read_text() == "old"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("version: 5", "version: 6", "version 6, this lipservo reads version 5"),
        ("version: 5", "version: 4", "version 4, this lipservo reads version 5"),
        ("version: 5\n", "", "version is missing"),
        ("version: 5", "version: one", "version is 'one', expected a whole number >= 0"),
        ("  jaw:\n", "  jaw: [\n", "line .*: not readable as YAML"),
        ("servos:", "joints:", "servos is missing"),
        ("weights: [", "weights: [.nan, ", r"servos\.jaw\.weights holds 6 numbers, expected 5"),
        ("max_deg: 40.0", "max_deg: .inf", r"servos\.jaw\.max_deg is inf, expected a finite"),
        ("max_deg: 40.0", "max_deg: wide", r"servos\.jaw\.max_deg is 'wide', expected a finite"),
        ("max_deg: 40.0", "max_deg: true", r"servos\.jaw\.max_deg is True, expected a finite"),
        ("max_deg: 40.0", "max_deg: -1", r"servos\.jaw: needs min_deg <= 0 <= max_deg"),
        ("max_deg: 40.0", "max_deg: " + "9" * 400, r"max_deg is 9+...9+, expected a finite number"),
        ("rest: [", "rest: [.nan, ", r"rest\[0\] is nan, expected a finite number"),
        ("rest: [", "rest: 1 # [", "rest must be a list of numbers"),
        (f'"{FACE}"', "7", "face_checksum is 7, expected text in quotes"),
        ("hold_out:\n", "hold_out: 3\nmore:\n", "hold_out must have `key: value` lines"),
        ("version: 5", "version: 2024-13-01", "not readable as YAML"),
    ],
)
def test_a_damaged_file_says_where_and_what_was_expected(calibration, tmp_path, old, new, message):
    path = tmp_path / "c.yaml"
    text = calibration_text(calibration)
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(CalibrationError, match=message) as caught:
        load_calibration(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def without_checksum(text):
    return "".join(
        line for line in text.splitlines(keepends=True) if not line.startswith("checksum:")
    )


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("max_deg: 40.0", "max_deg: 41.0"),
        ("n_closures: ", "n_closures: 1"),
        ("method: simulated face", "method: measured"),
        (f'"{FACE}"', '"0123456789abcdee"'),
    ],
)
def test_a_changed_digit_is_told_with_what_to_do(calibration, old, new):
    text = calibration_text(calibration)
    assert old in text
    with pytest.raises(CalibrationError, match="its checksum differs") as refused:
        parse_calibration(text.replace(old, new, 1), "face.calibration.yaml")
    assert str(refused.value).startswith("face.calibration.yaml: ")
    assert "delete the line `checksum:`" in str(refused.value)
    meant = without_checksum(text).replace(old, new, 1)
    assert "\nchecksum:" not in meant
    parse_calibration(meant, "x")


@settings(max_examples=30, deadline=None, suppress_health_check=list(HealthCheck))
@given(place=st.integers(0, 10_000), digit=st.sampled_from("0123456789"))
def test_no_digit_changes_what_is_read_without_being_noticed(calibration, place, digit):
    text = calibration_text(calibration)
    digits = [i for i, each in enumerate(text) if each.isdigit()]
    at = digits[place % len(digits)]
    changed = text[:at] + digit + text[at + 1 :]
    try:
        read = parse_calibration(changed, "x")
    except CalibrationError:
        return
    assert calibration_text(read) == text


def test_comments_spaces_and_trims_may_be_written_by_hand(calibration):
    text = calibration_text(calibration).replace("version: 5", "version:   5  # mine")
    by_hand = text + "trim:\n  P: {jaw: -1.5}\n"
    assert parse_calibration(by_hand, "x").trim["P"][0] == -1.5


def test_hand_poses_are_read_as_they_were_written(calibration):
    poses = {"closed": np.arange(10.0), "touched": np.linspace(-3.0, 4.0, 10).round(2)}
    with_poses = dataclasses.replace(calibration, hand_poses=poses)
    read = parse_calibration(calibration_text(with_poses), "x").hand_poses
    assert {name: degrees.tolist() for name, degrees in read.items()} == {
        name: degrees.tolist() for name, degrees in poses.items()
    }


@pytest.mark.parametrize("content", ["", "[]", "just words", "\x00\x01"])
def test_what_is_no_calibration_at_all_is_refused(tmp_path, content):
    path = tmp_path / "c.yaml"
    path.write_text(content)
    with pytest.raises(CalibrationError, match=r"key: value|not readable as YAML"):
        load_calibration(path)


@pytest.mark.parametrize("content", ["[" * 100_000, "{a: " * 5_000, "version: 5\n1: 2\n"])
def test_what_is_nested_deep_or_has_keys_of_no_text_is_one_line(tmp_path, content):
    path = tmp_path / "c.yaml"
    path.write_text(content)
    # libyaml of some computers gives up before our own limit is reached.
    refused = r"nested too deep|the key 1 must be text|line 1: not readable as YAML"
    with pytest.raises(CalibrationError, match=refused) as raised:
        load_calibration(path)
    assert "\n" not in str(raised.value)


def test_missing_and_binary_files_are_one_clear_line(tmp_path):
    with pytest.raises(CalibrationError, match=r"no such calibration; run `lipservo calibrate"):
        load_calibration(tmp_path / "none.yaml")
    with pytest.raises(CalibrationError, match="cannot be read"):
        load_calibration(tmp_path)
    (tmp_path / "b.yaml").write_bytes(b"\xff\xfe\xfa")
    with pytest.raises(CalibrationError, match="not a text file"):
        load_calibration(tmp_path / "b.yaml")


def test_every_missing_line_is_noticed(calibration):
    """Without any one line, the file is refused, or a calibration with that servo missing."""
    lines = calibration_text(calibration).splitlines()
    for i, line in enumerate(lines):
        if line.startswith(("#", "checksum:")):
            continue
        with pytest.raises(CalibrationError):
            check_calibration(
                parse_calibration("\n".join(lines[:i] + lines[i + 1 :]), "x"),
                small_model(),
                SERVOS,
                FACE,
            )


def test_a_calibration_of_this_model_and_face_passes(calibration, model):
    check_calibration(calibration, model, SERVOS, FACE)


def test_a_servo_without_calibration_is_named_with_the_remedy(calibration, model):
    with pytest.raises(CalibrationError, match=r"servo 'neck' has no .*run `lipservo calibrate"):
        check_calibration(calibration, model, (*SERVOS, "neck"), FACE)
    with pytest.raises(CalibrationError, match=r"calibrated servo 'lip_protrusion' is not in this"):
        check_calibration(calibration, model, SERVOS[:-1], FACE)


def test_another_model_or_face_is_refused_with_the_remedy(calibration, model):
    other = dataclasses.replace(model, mean_mm=model.mean_mm + 1.0)
    with pytest.raises(CalibrationError, match=r"made for model .*run `lipservo calibrate"):
        check_calibration(calibration, other, SERVOS, FACE)
    with pytest.raises(CalibrationError, match="another closed mouth"):
        check_calibration(
            calibration, dataclasses.replace(model, rest=model.rest + 1.0), SERVOS, FACE
        )
    with pytest.raises(CalibrationError, match=r"made for face 0123456789abcdef, this is face ff"):
        check_calibration(calibration, model, SERVOS, "ff")
    with pytest.raises(CalibrationError, match="made for face"):
        check_calibration(calibration, model, SERVOS[::-1], FACE)


def test_loading_needs_neither_scipy_nor_sklearn():
    code = (
        "import sys, calibration.files.calibration_file, calibration.simulated.face\n"
        "sys.exit(bool({'scipy', 'sklearn'} & set(sys.modules)))"
    )
    root = ROOT
    assert subprocess.run([sys.executable, "-c", code], cwd=root, check=False).returncode == 0


def test_a_calibration_with_no_number_in_it_leaves_the_good_file(calibration, tmp_path):
    path = tmp_path / "c.yaml"
    save_calibration(calibration, path)
    before = path.read_bytes()
    broken = dataclasses.replace(calibration, weights=calibration.weights * np.nan)
    with pytest.raises(CalibrationError, match=r"nothing is written.*weights\[0\] is '?nan"):
        save_calibration(broken, path)
    assert path.read_bytes() == before
    assert [each.name for each in tmp_path.iterdir()] == [path.name]
