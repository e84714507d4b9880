"""The Gaussian process over joints and skin, against dense algebra and SciPy's likelihood."""

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from scipy.stats import multivariate_normal

from calibration.fit.skin_process import (
    Hyperparameters,
    Poses,
    _NegativeLogLikelihood,
    fit_hyperparameters,
    fit_process,
    squared_distances_mm2,
)

RNG = np.random.default_rng(4)
NAMES = ("outer_lip_0", "outer_lip_17", "dot", "outer_lip_61")
PLACES_MM = RNG.normal(size=(4, 3)) * 8
APART_MM2 = squared_distances_mm2(NAMES, PLACES_MM)
POSES = Poses(RNG.uniform(-20, 20, (9, 2)), RNG.choice([-1.0, 1.0], (9, 2)), np.zeros(2),
              np.full(2, 20.0))  # fmt: skip
SETTING = Hyperparameters(np.array([0.8, 1.1]), np.array([2.0, 0.5]), 0.03, 0.2, 11.0)
VALUES_MM = RNG.normal(size=(9, 4, 3))


def dense(one, other):
    """The covariance (n * n_markers, m * n_markers) that the process stands for."""
    return np.kron(SETTING.pose_covariance(one, other), SETTING.skin_covariance(APART_MM2))


def test_predictions_are_those_of_the_dense_process():
    inputs = POSES.inputs(SETTING.backlash_deg)
    asked = RNG.uniform(-1, 1, (5, 2))
    noisy = dense(inputs, inputs) + SETTING.noise_mm2 * np.eye(9 * 4)
    expected = dense(asked, inputs) @ np.linalg.solve(noisy, VALUES_MM.reshape(36, 3))
    process = fit_process(SETTING, inputs, VALUES_MM, APART_MM2)
    assert process.predict(asked) == pytest.approx(expected.reshape(5, 4, 3), abs=1e-8)


def parameters(setting):
    rest = [setting.curvature, setting.noise_mm2, setting.width_mm]
    return np.concatenate([setting.backlash_deg, np.log(np.concatenate([setting.reach_mm2, rest]))])


def test_the_likelihood_is_scipys_and_its_slope_is_true():
    unlikeliness = _NegativeLogLikelihood(POSES, VALUES_MM, APART_MM2)
    inputs = POSES.inputs(SETTING.backlash_deg)
    noisy = dense(inputs, inputs) + SETTING.noise_mm2 * np.eye(36)
    density = multivariate_normal(np.zeros(36), noisy)
    log_likelihood = sum(density.logpdf(axis) for axis in VALUES_MM.reshape(36, 3).T)
    unlike = SETTING.backlash_deg - SETTING.backlash_deg.mean()
    expected = -log_likelihood - 1.5 * 36 * np.log(2 * np.pi) + (unlike**2).sum() / (2 * 0.4**2)
    cost, slope = unlikeliness(parameters(SETTING))
    assert cost == pytest.approx(expected)
    numeric = approx_fprime(parameters(SETTING), lambda p: unlikeliness(p)[0], 1e-6)
    assert slope == pytest.approx(numeric, rel=1e-3, abs=1e-3)


def test_a_setting_is_found_again_from_what_it_makes():
    """Noise within a tenth, skin width within a fifth, backlash within what 60 poses can show."""
    rng = np.random.default_rng(1)
    places_mm = rng.uniform(-30, 30, (20, 3))
    names = tuple(f"dot_{i}" for i in range(20))
    apart_mm2 = squared_distances_mm2(names, places_mm)
    made = Hyperparameters(np.array([0.6, 1.4]), np.array([9.0, 4.0]), 0.01, 0.25, 18.0)
    poses = Poses(
        rng.uniform(-20, 20, (60, 2)),
        rng.choice([-1.0, 1.0], (60, 2)),
        np.zeros(2),
        np.full(2, 20.0),
    )
    inputs = poses.inputs(made.backlash_deg)
    joints = np.linalg.cholesky(made.pose_covariance(inputs, inputs) + 1e-9 * np.eye(60))
    skin = np.linalg.cholesky(made.skin_covariance(apart_mm2) + 1e-4 * np.eye(20))
    true_mm = np.einsum("ni,ijk,mj->nmk", joints, rng.normal(size=(60, 20, 3)), skin)
    found = fit_hyperparameters(poses, true_mm + rng.normal(0, 0.5, true_mm.shape), apart_mm2)
    assert found.noise_mm2 == pytest.approx(0.25, rel=0.1)
    assert found.width_mm == pytest.approx(18.0, rel=0.2)
    assert found.backlash_deg == pytest.approx(made.backlash_deg, abs=0.3)


def test_gears_without_play_have_none_or_a_little_but_never_less():
    """Half of all noise would be read as play below 0."""
    rng = np.random.default_rng(7)
    goals_deg = rng.uniform(-20, 20, (40, 3))
    poses = Poses(goals_deg, rng.choice([-1.0, 1.0], (40, 3)), np.zeros(3), np.full(3, 20.0))
    seen_mm = np.einsum("nj,jmk->nmk", goals_deg / 20.0, rng.normal(0.0, 3.0, (3, 4, 3)))
    seen_mm += rng.normal(0.0, 0.5, seen_mm.shape)
    found_deg = fit_hyperparameters(poses, seen_mm, APART_MM2).backlash_deg
    assert (found_deg >= 0.0).all()
    assert found_deg.min() == 0.0
    assert found_deg.max() < 1.0


def test_the_lips_are_not_glued_together():
    """Upper and lower lip touch at rest, and are far apart along the skin."""
    touching_mm = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [0.0, 2.0, 0.0]])
    apart_mm2 = squared_distances_mm2(("inner_lip_13", "inner_lip_14", "outer_lip_0"), touching_mm)
    assert apart_mm2[0, 1] == pytest.approx(1.0 + 30.0**2)
    assert apart_mm2[0, 2] == pytest.approx(1.0)
