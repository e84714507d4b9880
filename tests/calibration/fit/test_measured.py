"""The measured way, from a simulated robot that nothing is known of to a calibration."""

import dataclasses

import numpy as np
import pytest
from scipy.optimize import lsq_linear
from small_model import small_model

from calibration.calibration import (
    CalibrationError,
    CouplingRule,
    Following,
    check_calibration,
    check_servo_models,
)
from calibration.capture.capture import Capture, capture_poses, plan_poses
from calibration.capture.sanity import check_capture
from calibration.closure import CLOSED_GAP_MM
from calibration.files.calibration_file import load_calibration, parse_calibration, save_calibration
from calibration.files.calibration_text import calibration_text
from calibration.fit.measured import MeasuredFit, fit_measured, lips_apart_mm, split_frames
from calibration.fit.retargeting import (
    MOST_EXAGGERATION,
    Correspondence,
    RobotMouth,
    ShapeFeatures,
    correspond,
)
from calibration.fit.robot_face import fit_robot_face
from calibration.fit.run_time_map import fit_run_time_map
from calibration.mouth_servos import JointRange, MouthServos
from calibration.simulated.face import POSITIVE_DIRECTIONS
from calibration.simulated.robot import SimulatedRobot, draw_robot, true_markers_mm
from lipsync.markers import MARKERS_47
from lipsync.phonemes import VISEME_CLASSES

SERVOS = tuple(POSITIVE_DIRECTIONS)
JOINTS = tuple(JointRange(name, -2.0 if name == "jaw" else -35.0, 35.0) for name in SERVOS)
MOUTH = MouthServos(JOINTS, "f" * 16, models=("XL330-M288",) * 10)
LIMITS = MOUTH.limits_deg
MODEL = small_model()
REST_MM = MODEL.markers_mm(MODEL.rest[None])[0]
DRAW = draw_robot(REST_MM, SERVOS, 101)


@pytest.fixture(scope="module")
def capture() -> Capture:
    robot = SimulatedRobot(DRAW, noise_seed=5)
    return capture_poses(plan_poses(JOINTS, 60), MARKERS_47.names, robot.move, robot.measure)


@pytest.fixture(scope="module")
def fit(capture) -> MeasuredFit:
    return fit_measured(MODEL, capture, MOUTH, date="2026-11-21")


def test_a_face_without_noise_is_learnt_to_a_tenth_of_a_millimetre():
    robot = SimulatedRobot(DRAW, noise_mm=0.0)
    clean = capture_poses(plan_poses(JOINTS, 60), MARKERS_47.names, robot.move, robot.measure)
    face = fit_robot_face(clean)
    poses_deg = np.random.default_rng(0).uniform(-12, 12, (50, 10)).clip(*LIMITS)
    missed_mm = face.markers_mm(poses_deg) - true_markers_mm(DRAW, poses_deg)
    assert np.sqrt(np.mean(missed_mm**2)) < 0.15
    assert face.backlash_deg[0] == pytest.approx(DRAW.backlash_deg[0], abs=0.1)


def test_with_noise_the_learnt_face_is_nearer_to_the_truth_than_the_tracker(capture):
    face = fit_robot_face(capture)
    poses_deg = np.random.default_rng(0).uniform(-12, 12, (50, 10)).clip(*LIMITS)
    missed_mm = face.markers_mm(poses_deg) - true_markers_mm(DRAW, poses_deg)
    assert np.sqrt(np.mean(missed_mm**2)) < 0.35
    assert 0.4 < face.noise_mm < face.left_out_rms_mm < 0.8
    assert face.backlash_deg[0] == pytest.approx(DRAW.backlash_deg[0], abs=0.25)


@pytest.mark.slow
def test_lost_points_hardly_matter(capture):
    lost_mm = capture.markers_mm.copy()
    lost_mm[np.random.default_rng(1).random((60, 47)) < 0.1] = np.nan
    face = fit_robot_face(dataclasses.replace(capture, markers_mm=lost_mm))
    poses_deg = np.random.default_rng(0).uniform(-12, 12, (50, 10)).clip(*LIMITS)
    missed_mm = face.markers_mm(poses_deg) - true_markers_mm(DRAW, poses_deg)
    assert np.sqrt(np.mean(missed_mm**2)) < 0.4


@pytest.mark.parametrize(
    ("one", "other"), [("inner_lip_14", "inner_lip_13"), ("outer_lip_291", "outer_lip_61")]
)
def test_one_dot_under_two_names_is_refused(capture, one, other):
    """There would be nothing to calibrate, and nothing off."""
    markers_mm = capture.markers_mm.copy()
    markers_mm[:, MARKERS_47.names.index(one)] = markers_mm[:, MARKERS_47.names.index(other)]
    with pytest.raises(CalibrationError, match=f"'{other}' and '{one}' are the same point in eve"):
        fit_measured(MODEL, dataclasses.replace(capture, markers_mm=markers_mm), MOUTH)


def test_two_dots_that_no_pose_shows_together_are_not_called_one(capture):
    one, other = (MARKERS_47.names.index(f"outer_lip_{n}") for n in (84, 314))
    markers_mm = capture.markers_mm.copy()
    markers_mm[::2, one] = markers_mm[1::2, other] = np.nan
    checked = check_capture(dataclasses.replace(capture, markers_mm=markers_mm), MODEL)
    assert any("outer_lip_84" in warning for warning in checked.warnings)


def test_a_mouth_that_never_opens_or_has_no_width_is_refused(capture):
    markers_mm = capture.markers_mm.copy()
    upper, lower = (MARKERS_47.names.index(f"inner_lip_{n}") for n in (13, 14))
    noise = np.random.default_rng(0).normal(0, 0.1, markers_mm[:, lower].shape)
    markers_mm[:, lower] = markers_mm[:, upper] + noise
    with pytest.raises(CalibrationError, match=r"inner_lip_13, inner_lip_14\) open by .* at most"):
        fit_measured(MODEL, with_few_markers(capture, markers_mm), MOUTH)
    narrow_mm = capture.markers_mm * np.array([0.1, 1.0, 1.0])
    with pytest.raises(
        CalibrationError, match=r"outer_lip_61 and outer_lip_291 are \d\.\d mm apart"
    ):
        fit_measured(MODEL, with_few_markers(capture, narrow_mm), MOUTH)


def with_few_markers(capture, markers_mm):
    names = ("inner_lip_13", "inner_lip_14", "outer_lip_61", "outer_lip_291", "chin_199",
             "outer_lip_0", "outer_lip_17", "outer_lip_39", "outer_lip_269")  # fmt: skip
    rows = [MARKERS_47.names.index(name) for name in names]
    return dataclasses.replace(capture, marker_names=names, markers_mm=markers_mm[:, rows])


def linear_mouth(slopes: np.ndarray, of: ShapeFeatures, limits_deg, rules=()) -> RobotMouth:
    """A mouth of n markers that are linear in the angles: slopes (n_servos, 3 n)."""

    def markers_of(angles_deg):
        return (angles_deg @ slopes).reshape(len(angles_deg), -1, 3)

    return RobotMouth(markers_of, Correspondence((), (), of, (0, 1)), limits_deg, rules)


def test_nearest_poses_of_a_linear_face_agree_with_scipy():
    rng = np.random.default_rng(3)
    slopes, wanted_mm = rng.normal(size=(4, 12)), 3.0 * rng.normal(size=(6, 4, 3))
    shape_features = ShapeFeatures(lips=(0, 1, 2, 3), gaps=((0, 1),))
    mouth = linear_mouth(slopes, shape_features, (np.full(4, -2.0), np.full(4, 1.0)))
    found = mouth.nearest_deg(shape_features.of(wanted_mm))
    system = shape_features.of(mouth.markers_of(np.eye(4))).T
    damped = np.vstack([system, 0.02 * np.eye(4)])
    for angles, wanted in zip(found, shape_features.of(wanted_mm), strict=True):
        expected = lsq_linear(damped, np.r_[wanted, np.zeros(4)], (-2.0, 1.0), method="bvls").x
        assert angles == pytest.approx(expected, abs=1e-4)


def test_a_coupling_rule_is_kept():
    shape_features = ShapeFeatures(lips=(0, 1), gaps=((0, 1),))
    slopes = np.zeros((2, 6))
    slopes[0, 1], slopes[1, 4] = 1.0, 1.0  # each servo lifts one marker
    wanted_mm = np.tile([[0.0, 4.0, 0.0], [0.0, 4.0, 0.0]], (5, 1, 1))
    wanted_mm[2] = 0.0
    limits = (np.full(2, -9.0), np.full(2, 9.0))
    wanted = shape_features.of(wanted_mm)
    free = linear_mouth(slopes, shape_features, limits).nearest_deg(wanted)
    rule = CouplingRule(np.array([1.0, 1.0]), 6.0)
    ruled = linear_mouth(slopes, shape_features, limits, (rule,)).nearest_deg(wanted)
    assert free[0] == pytest.approx([4.0, 4.0], abs=0.01)
    assert ruled[0].sum() == pytest.approx(6.0, abs=0.15)


def test_the_run_time_map_finds_a_quadratic_law_again():
    rng = np.random.default_rng(4)
    x = rng.uniform(-5, 5, (400, 2))
    products = np.column_stack([x[:, 0] ** 2, x[:, 0] * x[:, 1], x[:, 1] ** 2])
    weights, quadratic_weights = (
        np.array([[1.0, -2.0], [0.5, 3.0]]),
        np.array([[0.1, 0, 0.2], [0, -0.3, 0]]),
    )
    angles = np.array([1.5, -0.5]) + x @ weights.T + products @ quadratic_weights.T
    found = fit_run_time_map(x, angles)
    assert found["weights"] == pytest.approx(weights, abs=0.05)
    assert found["quadratic_weights"] == pytest.approx(quadratic_weights, abs=0.02)
    assert found["rest_deg"] == pytest.approx([1.5, -0.5], abs=0.05)
    assert found["x_range"] == pytest.approx(np.array([x.min(axis=0), x.max(axis=0)]), rel=1e-5)


def test_markers_that_no_model_knows_or_that_are_missing_are_named():
    with pytest.raises(CalibrationError, match="unknown marker 'dot_7'"):
        correspond((*MARKERS_47.names, "dot_7"))
    with pytest.raises(CalibrationError, match="marker 'outer_lip_61' is needed"):
        correspond([name for name in MARKERS_47.names if name != "outer_lip_61"])


def held_out_lips_mm(fit: MeasuredFit) -> np.ndarray:
    x = fit.held_out - MODEL.rest
    poses_deg = np.array([fit.calibration.positions_deg(frame) for frame in fit.held_out])
    robot_mm = true_markers_mm(DRAW, poses_deg)
    return lips_apart_mm(robot_mm, fit.retargeting.targets_mm(x), list(MARKERS_47.lips))


def test_the_real_robot_makes_the_held_out_shapes(fit):
    assert np.sqrt(np.mean(held_out_lips_mm(fit) ** 2)) < 0.8
    assert not fit.warnings


def test_closed_lips_of_the_speaker_are_closed_lips_of_the_robot(fit):
    frames = MODEL.animphos.frames
    gaps_mm = np.array([MODEL.lip_gap_mm(frame) for frame in frames])
    poses_deg = np.array([fit.calibration.positions_deg(frame) for frame in frames])
    robot_mm = true_markers_mm(DRAW, poses_deg)
    robot_gaps_mm = robot_mm[:, MARKERS_47.upper_lip, 1] - robot_mm[:, MARKERS_47.lower_lip, 1]
    closed = gaps_mm <= CLOSED_GAP_MM
    assert closed.sum() > 20
    assert robot_gaps_mm[closed].max() < 0.3
    assert np.corrcoef(gaps_mm, robot_gaps_mm)[0, 1] > 0.98


def test_the_robot_is_asked_for_as_much_as_it_can_but_no_caricature(fit):
    assert 0.5 < fit.retargeting.scale <= MOST_EXAGGERATION


def test_touch_is_where_the_lips_just_meet(fit):
    robot_mm = true_markers_mm(DRAW, fit.calibration.touch.positions_deg[None])[0]
    assert abs(robot_mm[MARKERS_47.upper_lip, 1] - robot_mm[MARKERS_47.lower_lip, 1]) < 0.4


def test_the_calibration_grades_itself_honestly(fit):
    """What the file says of its errors is near what the real robot does, noise set aside."""
    errors = fit.calibration.errors
    assert errors.n_frames == len(fit.held_out) == 5 * 16
    assert 0.0 <= errors.nearest_lip_rms_mm <= errors.lip_rms_mm
    assert abs(errors.lip_rms_mm - np.sqrt(np.mean(held_out_lips_mm(fit) ** 2))) < 0.5
    known = {viseme[0] for viseme in VISEME_CLASSES if set(viseme) & MODEL.animphos.known_phonemes}
    assert set(fit.calibration.coverage) == known
    assert all(0.0 <= reach.reachable <= 1.0 for reach in fit.calibration.coverage.values())


def test_fit_and_held_out_frames_are_of_different_animphos():
    fitted, held_out = split_frames(MODEL, 0)
    assert len(fitted) + len(held_out) == 5 * len(MODEL.animphos)


@pytest.mark.slow
def test_the_same_capture_gives_the_same_file(fit, capture):
    again = fit_measured(MODEL, capture, MOUTH, date="2026-11-21")
    assert calibration_text(again.calibration) == calibration_text(fit.calibration)


def test_a_measured_calibration_is_loaded_as_it_was(fit, tmp_path):
    path = tmp_path / "face.calibration.yaml"
    full = dataclasses.replace(
        fit.calibration,
        following=Following(
            np.full(10, 0.06), np.full(10, 1.1), np.full(10, 300.0), np.arange(10.0)
        ),
        trim={"P": np.arange(10.0)},
    )  # fmt: skip
    save_calibration(full, path)
    loaded = load_calibration(path)
    assert calibration_text(loaded) == path.read_text()
    frame = MODEL.animphos.samples[3, 2]
    assert loaded.positions_deg(frame) == pytest.approx(full.positions_deg(frame), abs=1e-9)
    assert loaded.origin == full.origin
    assert loaded.following.bandwidth_hz.tolist() == list(range(10))
    assert loaded.trim["P"].tolist() == list(range(10))
    check_calibration(loaded, MODEL, SERVOS, "f" * 16)


def test_the_previous_file_is_kept_and_a_power_cut_leaves_the_old_one(fit, tmp_path, monkeypatch):
    path = tmp_path / "c.yaml"
    save_calibration(fit.calibration, path)
    first = path.read_text()
    newer = dataclasses.replace(fit.calibration, face_checksum="0" * 16)

    def power_cut(_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr("lipsync.output_file.os.fsync", power_cut)
        with pytest.raises(KeyboardInterrupt):
            save_calibration(newer, path)
    assert path.read_text() == first
    save_calibration(newer, path)
    assert path.with_name("c.yaml.previous").read_text() == first
    assert load_calibration(path).face_checksum == "0" * 16


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (
            "quadratic_weights: [",
            "quadratic_weights: [1.0, ",
            r"servos\.jaw\.quadratic_weights holds 16 numbers, expected 15",
        ),
        ("x_least: [", "x_lowest: [", "x_least is missing"),
        ("lag_s: ", "late_s: ", r"servos\.jaw\.lag_s is missing"),
        ("trim:", "trim: {Q: {jaw: 1.0}}\nx:", r"trim\.Q: unknown viseme; use one of SIL P"),
        ("trim:", "trim: {P: {tail: 1.0}}\nx:", r"trim\.P\.tail: this file has no servo tail"),
    ],
)
def test_damage_to_the_newer_parts_is_named(fit, old, new, message):
    full = dataclasses.replace(fit.calibration, trim={"P": np.ones(10)})
    text = calibration_text(full)
    assert old in text
    with pytest.raises(CalibrationError, match=message):
        parse_calibration(text.replace(old, new, 1), "c.yaml")


def test_a_servo_exchanged_for_another_model_is_refused_with_the_remedy(fit):
    check_servo_models(fit.calibration, ["XL330-M288"] * 10)
    with pytest.raises(
        CalibrationError, match=r"'jaw' was calibrated as a XL330-M288 and is a XM430-W350 .*run `"
    ):
        check_servo_models(fit.calibration, ["XM430-W350"] + ["XL330-M288"] * 9)


def test_a_file_from_which_the_model_of_a_servo_was_deleted_is_refused(fit):
    text = calibration_text(fit.calibration).replace("    model: XL330-M288\n", "", 1)
    with pytest.raises(CalibrationError, match="its checksum differs"):
        parse_calibration(text, "c.yaml")
