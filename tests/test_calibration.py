import dataclasses
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import lsq_linear
from small_model import small_model

from calibration.calibration import Calibration, CalibrationError, check_calibration
from calibration.calibration_file import (
    calibration_text,
    load_calibration,
    parse_calibration,
    save_calibration,
)
from calibration.fitting import fit_calibration, ridge_weights
from calibration.hold_out import measure_hold_out
from calibration.joint_range import JointRange
from calibration.nearest_pose import bounded_minimum, nearest_positions_deg
from calibration.simulated_face import (
    POSITIVE_DIRECTIONS,
    SimulatedFace,
    marker_positions_mm,
    simulated_face,
)
from lipsync.animpho.model import FaceModel
from lipsync.markers import LOWER_INNER_LIP, UPPER_INNER_LIP

SERVOS = tuple(POSITIVE_DIRECTIONS)
JOINTS = tuple(JointRange(name, -40.0, 40.0) for name in SERVOS)
FACE = "0123456789abcdef"


@pytest.fixture(scope="module")
def model() -> FaceModel:
    return small_model()


@pytest.fixture(scope="module")
def calibration(model) -> Calibration:
    return fit_calibration(model, JOINTS, FACE)


@pytest.fixture(scope="module")
def face(model) -> SimulatedFace:
    return simulated_face(model.markers_mm(model.rest[None])[0], SERVOS)


def model_of_the_face(face: SimulatedFace, model: FaceModel, drive: np.ndarray) -> FaceModel:
    """A talker whose every frame the face can reach: drive (n_servos, 5) degrees a unit."""
    tenth_deg = 0.1  # of such small angles the face is linear
    columns = [
        (marker_positions_mm(face, tenth_deg * d[None])[0] - face.neutral_mm) / tenth_deg
        for d in drive.T
    ]
    q, r = np.linalg.qr(np.array(columns).reshape(5, -1).T)
    animphos = np.random.default_rng(3).uniform(-1, 1, (40, 5, 5)) @ r.T
    return dataclasses.replace(
        model, mean_mm=face.neutral_mm, basis=q.T, rest=np.zeros(5), animphos=animphos
    )


def test_rest_is_exactly_neutral(calibration, model):
    assert np.array_equal(calibration.positions_deg(model.rest), np.zeros(10))


def test_positions_are_weights_times_distance_from_rest_within_limits(calibration):
    small = dataclasses.replace(
        calibration,
        servo_names=("a", "b"),
        weights=np.array([[2.0, 0.0], [1.0, -1.0]]),
        bends=np.zeros((2, 0)),
        rest=np.array([1.0, 1.0]),
        rest_deg=np.zeros(2),
        x_range=np.array([[-np.inf] * 2, [np.inf] * 2]),
        min_deg=np.array([-3.0, -3.0]),
        max_deg=np.array([5.0, 5.0]),
    )
    assert small.positions_deg(np.array([2.0, 2.0])).tolist() == [2.0, 0.0]
    assert small.positions_deg(np.array([9.0, 1.0])).tolist() == [5.0, 5.0]
    assert small.positions_deg(np.array([-9.0, 1.0])).tolist() == [-3.0, -3.0]


def test_bounded_minimum_agrees_with_scipy():
    rng = np.random.default_rng(0)
    systems, rights = rng.normal(size=(20, 12, 4)), rng.normal(size=(20, 12))
    lower, upper = np.full(4, -0.2), np.array([0.1, 0.2, 0.3, 0.0])
    ours = bounded_minimum(
        np.einsum("nki,nkj->nij", systems, systems),
        np.einsum("nki,nk->ni", systems, rights),
        lower,
        upper,
    )
    for x, system, right in zip(ours, systems, rights, strict=True):
        expected = lsq_linear(system, right, (lower, upper), method="bvls").x
        assert x == pytest.approx(expected, abs=1e-6)


def test_poses_of_the_face_itself_are_found_again(face):
    """No two servos look alike; the pull to neutral costs less than half a degree."""
    wanted_deg = np.random.default_rng(4).uniform(-15, 15, (20, 10))
    limits = np.full(10, 40.0)
    found_deg = nearest_positions_deg(face, marker_positions_mm(face, wanted_deg), -limits, limits)
    assert np.abs(found_deg - wanted_deg).max() < 0.5


def test_a_pose_outside_the_limits_ends_at_them(face):
    wanted_deg = np.zeros((1, 10))
    wanted_deg[0, 0] = 20.0
    limits = np.full(10, 12.0)
    found_deg = nearest_positions_deg(face, marker_positions_mm(face, wanted_deg), -limits, limits)
    assert found_deg[0, 0] == 12.0
    assert np.abs(found_deg).max() <= 12.0


def test_ridge_weights_solve_the_normal_equations():
    rng = np.random.default_rng(5)
    from_rest, truth = rng.normal(size=(500, 5)), rng.normal(size=(3, 5))
    positions_deg = from_rest @ truth.T + rng.normal(size=(500, 3))
    candidates = [
        np.linalg.solve(from_rest.T @ from_rest + alpha * np.eye(5), from_rest.T @ positions_deg).T
        for alpha in np.logspace(-2, 6, 17)
    ]
    weights = ridge_weights(from_rest, positions_deg)
    assert min(np.abs(weights - c).max() for c in candidates) < 1e-5


def test_the_fit_recovers_known_angles_when_the_human_is_the_simulated_face(face, model):
    drive_deg = np.random.default_rng(6).uniform(-1, 1, (10, 5))
    twin = model_of_the_face(face, model, drive_deg)
    fitted = fit_calibration(twin, JOINTS, FACE)
    for frame in np.random.default_rng(7).uniform(-1, 1, (20, 5)):
        frame_coefficients = np.linalg.lstsq(
            twin.basis.T, _tenth_motion(face, drive_deg @ frame), rcond=None
        )[0]
        assert fitted.positions_deg(frame_coefficients) == pytest.approx(
            drive_deg @ frame, abs=0.15
        )
    assert fitted.errors.marker_rms_mm < 0.05
    assert fitted.errors.gap_rms_mm < 0.05
    assert fitted.errors.clipped_share == 0.0


def _tenth_motion(face: SimulatedFace, positions_deg: np.ndarray) -> np.ndarray:
    moved = marker_positions_mm(face, 0.1 * positions_deg[None])[0] - face.neutral_mm
    return moved.ravel() / 0.1


def test_a_closed_human_mouth_is_a_closed_robot_mouth(calibration, model, face):
    for phoneme in ("SIL", "M"):
        for frame in model.animphos[model.of_phoneme(phoneme), 2]:
            markers_mm = marker_positions_mm(face, calibration.positions_deg(frame)[None])[0]
            gap_mm = np.linalg.norm(markers_mm[UPPER_INNER_LIP] - markers_mm[LOWER_INNER_LIP])
            assert gap_mm < 0.5
    assert calibration.errors.n_closures > 0
    assert calibration.errors.gap_correlation > 0.99


def test_an_open_vowel_opens_the_jaw_and_a_rounded_one_narrows_the_mouth(calibration, model):
    open_deg, round_deg = (
        dict(zip(SERVOS, calibration.positions_deg(model.animphos[animpho, 2]), strict=True))
        for animpho in (model.of_phoneme("AA")[0], model.of_phoneme("UW")[0])
    )
    assert open_deg["jaw"] > 2.0 * round_deg["jaw"] > 0.0
    assert round_deg["corner_left_out"] < 0.0 > round_deg["corner_right_out"]


def test_the_same_seed_gives_the_same_calibration_and_another_seed_another(model, calibration):
    assert calibration_text(fit_calibration(model, JOINTS, FACE)) == calibration_text(calibration)
    assert calibration_text(fit_calibration(model, JOINTS, FACE, seed=1)) != calibration_text(
        calibration
    )


def test_held_out_animphos_do_not_change_the_weights(model, calibration):
    """The first fifth of the seeded order is held out: bend those AnimPhos, only errors change."""
    order = np.random.default_rng(0).permutation(len(model.animphos))
    bent = model.animphos.copy()
    bent[order[: len(order) // 5]] += 5.0
    other = fit_calibration(dataclasses.replace(model, animphos=bent), JOINTS, FACE)
    assert np.array_equal(other.weights, calibration.weights)
    assert other.errors != calibration.errors


def test_narrow_limits_are_kept_and_counted(model):
    narrow = [JointRange(name, -1.0, 1.0) for name in SERVOS]
    fitted = fit_calibration(model, narrow, FACE)
    assert np.abs(fitted.positions_deg(np.full(5, 1e3))).max() == 1.0
    assert fitted.errors.clipped_share > 0.2


def test_hold_out_errors_match_numbers_by_hand():
    human_mm, robot_mm = np.zeros((2, 47, 3)), np.zeros((2, 47, 3))
    human_mm[1, UPPER_INNER_LIP, 1] = 3.0
    robot_mm[0, LOWER_INNER_LIP, 1] = -2.0
    errors = measure_hold_out(
        human_mm, robot_mm, human_mm, np.array([[3.0], [-4.0]]), np.array([True, False])
    )
    assert errors.n_frames == 2
    assert errors.marker_rms_mm == pytest.approx(np.sqrt((9 + 4) / (2 * 47)))
    assert errors.lip_rms_mm == pytest.approx(np.sqrt((9 + 4) / (2 * 20)))
    assert errors.nearest_lip_rms_mm == 0.0
    assert errors.gap_rms_mm == pytest.approx(np.sqrt((2**2 + 3**2) / 2))
    assert errors.gap_correlation == pytest.approx(-1.0)
    assert (errors.n_closures, errors.closed_gap_mm) == (1, 2.0)
    assert errors.clipped_share == 0.5
    assert errors.joint_rms_deg == pytest.approx((np.sqrt(12.5),))


def test_a_face_that_never_moves_has_no_correlation_and_no_warning():
    still = np.zeros((3, 47, 3))
    still[:, UPPER_INNER_LIP, 1] = 5.0
    errors = measure_hold_out(still, still, still, np.zeros((3, 1)), np.zeros(3, dtype=bool))
    assert (errors.gap_correlation, errors.n_closures, errors.closed_gap_mm) == (0.0, 0, 0.0)


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


def test_many_frames_are_still_a_whole_number_in_the_file(calibration):
    errors = dataclasses.replace(calibration.errors, n_frames=123457)
    many = dataclasses.replace(calibration, errors=errors)
    assert parse_calibration(calibration_text(many), "x").errors.n_frames == 123457


def test_tiny_weights_are_numbers_in_the_file(calibration):
    tiny = dataclasses.replace(calibration, weights=np.full((10, 5), 1e-7))
    assert parse_calibration(calibration_text(tiny), "x").weights[0, 0] == 1e-7


def test_a_file_that_cannot_be_written_is_one_clear_line(calibration, tmp_path):
    with pytest.raises(CalibrationError, match="cannot be written: No such file or directory"):
        save_calibration(calibration, tmp_path / "nowhere" / "c.yaml")


def test_a_failed_write_leaves_the_old_file(calibration, tmp_path):
    path = tmp_path / "c.yaml"
    path.write_text("old")
    (tmp_path / "c.yaml.partial").mkdir()
    with pytest.raises(CalibrationError, match="cannot be written"):
        save_calibration(calibration, path)
    assert path.read_text() == "old"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("version: 2", "version: 3", "version 3, this lipservo reads version 2"),
        ("version: 2\n", "", "version is missing"),
        ("version: 2", "version: one", "version is 'one', expected a whole number >= 0"),
        ("  jaw:\n", "  jaw: [\n", "line .*: not readable as YAML"),
        ("servos:", "joints:", "servos is missing"),
        ("weights: [", "weights: [.nan, ", r"servos\.jaw\.weights holds 6 numbers, expected 5"),
        ("max_deg: 40.0", "max_deg: .inf", r"servos\.jaw\.max_deg is inf, expected a finite"),
        ("max_deg: 40.0", "max_deg: wide", r"servos\.jaw\.max_deg is 'wide', expected a finite"),
        ("max_deg: 40.0", "max_deg: true", r"servos\.jaw\.max_deg is True, expected a finite"),
        ("max_deg: 40.0", "max_deg: -1", r"servos\.jaw: needs min_deg <= 0 <= max_deg"),
        ("max_deg: 40.0", "max_deg: " + "9" * 400, r"max_deg is 9+, expected a finite number"),
        ("rest: [", "rest: [.nan, ", r"rest\[0\] is nan, expected a finite number"),
        ("rest: [", "rest: 1 # [", "rest should be a list of numbers"),
        (f'"{FACE}"', "7", "face_checksum is 7, expected text in quotes"),
        ("hold_out:\n", "hold_out: 3\nmore:\n", "hold_out should hold `key: value` lines"),
        ("version: 2", "version: 2024-13-01", "not readable as YAML"),
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


@pytest.mark.parametrize("content", ["", "[]", "just words", "\x00\x01"])
def test_what_is_no_calibration_at_all_is_refused(tmp_path, content):
    path = tmp_path / "c.yaml"
    path.write_text(content)
    with pytest.raises(CalibrationError, match=r"key: value|not readable as YAML"):
        load_calibration(path)


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
        if line.startswith("#"):
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


@pytest.mark.parametrize("limits", [(1.0, 5.0), (-5.0, -1.0), (float("nan"), 1.0), (-1.0, np.inf)])
def test_a_joint_range_needs_zero_inside_finite_limits(limits):
    with pytest.raises(CalibrationError, match=r"servo 'jaw': needs min_deg <= 0 <= max_deg"):
        JointRange("jaw", *limits)


def test_fitting_an_unknown_servo_is_one_clear_line(model):
    with pytest.raises(CalibrationError, match="servo 'tail' has no place in the simulated face"):
        fit_calibration(model, [JointRange("tail", -1.0, 1.0)], FACE)


def test_loading_needs_neither_scipy_nor_sklearn():
    code = (
        "import sys, calibration.calibration_file, calibration.simulated_face\n"
        "sys.exit(bool({'scipy', 'sklearn'} & set(sys.modules)))"
    )
    root = Path(__file__).parents[1]
    assert subprocess.run([sys.executable, "-c", code], cwd=root, check=False).returncode == 0
