"""A calibration fitted to the simulated face: poses, weights, errors."""

import dataclasses
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear
from small_model import small_model

from calibration.calibration import Calibration, CalibrationError, CouplingRule, keep_rules
from calibration.files.calibration_text import calibration_text
from calibration.fit.learnt_face import fit_calibration, ridge_weights
from calibration.fit.retargeting import RobotMouth, bounded_minimum, correspond
from calibration.grade import measure_hold_out
from calibration.mouth_servos import JointRange
from calibration.simulated.face import (
    POSITIVE_DIRECTIONS,
    SimulatedFace,
    marker_positions_mm,
    simulated_face,
)
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.markers import MARKERS_47

SERVOS = tuple(POSITIVE_DIRECTIONS)
JOINTS = tuple(JointRange(name, -40.0, 40.0) for name in SERVOS)
FACE = "0123456789abcdef"


@pytest.fixture(scope="module")
def model() -> FaceWithAnimPhos:
    return small_model()


@pytest.fixture(scope="module")
def calibration(model) -> Calibration:
    return fit_calibration(model, JOINTS, FACE)


@pytest.fixture(scope="module")
def face(model) -> SimulatedFace:
    return simulated_face(model.markers_mm(model.rest[None])[0], SERVOS)


def with_samples(model: FaceWithAnimPhos, samples: np.ndarray) -> FaceWithAnimPhos:
    """The same face with other AnimPhos, in the same tables."""
    units = dataclasses.replace(model.animphos, samples=samples)
    return dataclasses.replace(model, animphos=units)


def model_of_the_face(
    face: SimulatedFace, model: FaceWithAnimPhos, drive: np.ndarray
) -> FaceWithAnimPhos:
    """A speaker whose every frame the face can reach: drive (n_servos, 5) degrees a unit."""
    tenth_deg = 0.1  # of such small angles the face is linear
    columns = [
        (marker_positions_mm(face, tenth_deg * d[None])[0] - face.neutral_mm) / tenth_deg
        for d in drive.T
    ]
    q, r = np.linalg.qr(np.array(columns).reshape(5, -1).T)
    animphos = np.random.default_rng(3).uniform(-1, 1, (40, 5, 5)) @ r.T
    face_model = dataclasses.replace(model, mean_mm=face.neutral_mm, basis=q.T, rest=np.zeros(5))
    return with_samples(face_model, animphos)


def test_rest_is_exactly_neutral(calibration, model):
    assert np.array_equal(calibration.positions_deg(model.rest), np.zeros(10))


def test_positions_are_weights_times_distance_from_rest_within_limits(calibration):
    small = dataclasses.replace(
        calibration,
        servo_names=("a", "b"),
        weights=np.array([[2.0, 0.0], [1.0, -1.0]]),
        quadratic_weights=np.zeros((2, 0)),
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


def mouth(face: SimulatedFace, limits: np.ndarray) -> RobotMouth:
    names = correspond(MARKERS_47.names)
    return RobotMouth(partial(marker_positions_mm, face), names, (-limits, limits))


def features(face: SimulatedFace, positions_deg: np.ndarray) -> np.ndarray:
    return correspond(MARKERS_47.names).shape_features.of(marker_positions_mm(face, positions_deg))


def test_poses_of_the_face_itself_are_found_again(face):
    """No two servos look alike; the pull to neutral costs less than half a degree."""
    wanted_deg = np.random.default_rng(4).uniform(-15, 15, (20, 10))
    limits = np.full(10, 40.0)
    found_deg = mouth(face, limits).nearest_deg(features(face, wanted_deg))
    assert np.abs(found_deg - wanted_deg).max() < 0.5


def test_a_pose_outside_the_limits_ends_at_them(face):
    wanted_deg = np.zeros((1, 10))
    wanted_deg[0, 0] = 20.0
    limits = np.full(10, 12.0)
    found_deg = mouth(face, limits).nearest_deg(features(face, wanted_deg))
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
        for frame in model.animphos.samples[model.animphos.of_phoneme(phoneme), 2]:
            markers_mm = marker_positions_mm(face, calibration.positions_deg(frame)[None])[0]
            gap_mm = np.linalg.norm(MARKERS_47.gap_vectors_mm(markers_mm[None])[0])
            assert gap_mm < 0.5
    assert calibration.errors.n_closures > 0
    assert calibration.errors.gap_correlation > 0.99


def test_an_open_vowel_opens_the_jaw_and_a_rounded_one_narrows_the_mouth(calibration, model):
    open_deg, round_deg = (
        dict(
            zip(SERVOS, calibration.positions_deg(model.animphos.samples[animpho, 2]), strict=True)
        )
        for animpho in (model.animphos.of_phoneme("AA")[0], model.animphos.of_phoneme("UW")[0])
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
    bent = model.animphos.samples.copy()
    bent[order[: len(order) // 5]] += 5.0
    other = fit_calibration(with_samples(model, bent), JOINTS, FACE)
    assert np.array_equal(other.weights, calibration.weights)
    assert other.errors != calibration.errors


def test_narrow_limits_are_kept_and_counted(model):
    narrow = [JointRange(name, -1.0, 1.0) for name in SERVOS]
    fitted = fit_calibration(model, narrow, FACE)
    assert np.abs(fitted.positions_deg(np.full(5, 1e3))).max() == 1.0
    assert fitted.errors.clipped_share > 0.2


RULES = (
    CouplingRule(np.eye(10)[0] + np.eye(10)[1], 6.0),
    CouplingRule(np.eye(10)[3] - 0.5 * np.eye(10)[0], 2.0),
)


def test_no_pose_of_a_calibration_breaks_a_rule_between_joints(model):
    """Neither the poses of speech nor what a coefficient far outside of it gives."""
    fitted = fit_calibration(model, JOINTS, FACE, rules=RULES)
    free = fit_calibration(model, JOINTS, FACE)
    frames = model.animphos.frames
    wild = np.random.default_rng(1).normal(size=(200, 5)) * 60.0
    broken = 0
    for frame in [*frames, *wild]:
        for rule in RULES:
            assert rule.weights @ fitted.positions_deg(frame) <= rule.at_most_deg + 1e-9
            broken += rule.weights @ free.positions_deg(frame) > rule.at_most_deg
    assert broken > 100  # without rules they would be


def test_the_fit_knows_the_rules_and_finds_another_way_to_open_the_mouth(model):
    """A jaw that must not open far with the upper lip up: the lower lip goes farther down."""
    fitted = fit_calibration(model, JOINTS, FACE, rules=RULES[:1])
    only_kept = dataclasses.replace(fit_calibration(model, JOINTS, FACE), rules=RULES[:1])
    wide = model.animphos.samples[model.animphos.of_phoneme("AA"), 2]
    lower = [SERVOS.index(f"lower_lip_{side}") for side in ("left", "right")]
    by_fit = np.median([fitted.positions_deg(f)[lower].sum() for f in wide])
    by_cut = np.median([only_kept.positions_deg(f)[lower].sum() for f in wide])
    assert by_fit > by_cut + 1.0


@settings(deadline=None)  # machines are shared
@given(seed=st.integers(0, 9999), n_rules=st.integers(1, 4))
def test_rules_are_kept_within_the_limits_whatever_they_say(seed, n_rules):
    rng = np.random.default_rng(seed)
    rules = [
        CouplingRule(rng.integers(-2, 3, 6).astype(float), float(rng.uniform(0, 20)))
        for _ in range(n_rules)
    ]
    low, high = -rng.uniform(0, 40, 6), rng.uniform(0, 40, 6)
    wanted = rng.uniform(low, high)
    kept = keep_rules(rules, wanted)
    assert all(rule.weights @ kept <= rule.at_most_deg + 1e-6 for rule in rules)
    assert ((low <= kept) & (kept <= high)).all()
    if all(rule.weights @ wanted <= rule.at_most_deg for rule in rules):
        assert np.array_equal(kept, wanted)


def test_hold_out_errors_match_numbers_by_hand():
    human_mm, robot_mm = np.zeros((2, 47, 3)), np.zeros((2, 47, 3))
    human_mm[1, MARKERS_47.upper_lip, 1] = 3.0
    robot_mm[0, MARKERS_47.lower_lip, 1] = -2.0
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
    each = errors.each_marker_rms_mm
    assert each.pop("inner_lip_13") == pytest.approx(np.sqrt(9 / 2))
    assert each.pop("inner_lip_14") == pytest.approx(np.sqrt(4 / 2))
    assert set(each.values()) == {0.0}


def test_a_face_that_never_moves_has_no_correlation_and_no_warning():
    still = np.zeros((3, 47, 3))
    still[:, MARKERS_47.upper_lip, 1] = 5.0
    errors = measure_hold_out(still, still, still, np.zeros((3, 1)), np.zeros(3, dtype=bool))
    assert (errors.gap_correlation, errors.n_closures, errors.closed_gap_mm) == (0.0, 0, 0.0)


@pytest.mark.parametrize("limits", [(1.0, 5.0), (-5.0, -1.0), (float("nan"), 1.0), (-1.0, np.inf)])
def test_a_joint_range_needs_zero_inside_finite_limits(limits):
    with pytest.raises(CalibrationError, match=r"servo 'jaw': needs min_deg <= 0 <= max_deg"):
        JointRange("jaw", *limits)


def test_fitting_an_unknown_servo_is_one_clear_line(model):
    with pytest.raises(CalibrationError, match="servo 'tail' is not in the simulated face"):
        fit_calibration(model, [JointRange("tail", -1.0, 1.0)], FACE)
