"""Weighted components against scikit-learn's, and thinning against counting."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from lipservo_lab.learning.motion.frame_statistics import counted, principal_components
from sklearn.decomposition import PCA


@pytest.fixture
def frames():
    rng = np.random.default_rng(0)
    return rng.normal(size=(300, 12)) @ rng.normal(size=(12, 12)) + 5.0


def test_equal_weights_give_what_scikit_learn_gives(frames):
    theirs = PCA(4, svd_solver="covariance_eigh").fit(frames)
    for weight in (1.0, 0.3):
        ours = principal_components(frames, np.full(300, weight), 4)
        np.testing.assert_allclose(ours.basis, theirs.components_, atol=1e-9)
        np.testing.assert_allclose(ours.mean, theirs.mean_)
        np.testing.assert_allclose(ours.coefficients(frames), theirs.transform(frames), atol=1e-8)
        assert ours.variance_held == pytest.approx(theirs.explained_variance_ratio_.sum())


def test_a_weight_of_two_is_being_there_twice(frames):
    weights = np.random.default_rng(1).integers(1, 4, 300)
    weighted = principal_components(frames, weights.astype(float), 4)
    repeated = principal_components(np.repeat(frames, weights, axis=0), np.ones(weights.sum()), 4)
    np.testing.assert_allclose(weighted.basis, repeated.basis, atol=1e-9)


@given(n=st.integers(1, 500), weight=st.floats(0.001, 20.0))
def test_everything_is_there_as_often_as_it_counts(n, weight):
    chosen = counted(n, weight)
    assert len(chosen) == max(1, round(n * weight))
    times = np.bincount(chosen, minlength=n)
    assert (np.diff(chosen) >= 0).all()
    if len(chosen) > 1:
        assert times.max() - times.min() <= 1
