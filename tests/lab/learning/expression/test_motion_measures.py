import numpy as np
import pytest
from expression_tracks import sway
from lipservo_lab.learning.expression.expression_training import (
    canonical_correlation,
    head_correlation,
    head_lag_s,
    log_psd_distance_db,
)
from sklearn.cross_decomposition import CCA


def test_the_canonical_correlation_is_scikit_learn_s():
    rng = np.random.default_rng(0)
    x = rng.standard_normal((400, 3))
    y = np.column_stack((x[:, 0] + rng.standard_normal(400), rng.standard_normal((400, 2))))
    ours = canonical_correlation(x, y)
    u, v = CCA(1, max_iter=5000, tol=1e-12).fit_transform(x, y)

    assert ours == pytest.approx(np.corrcoef(u[:, 0], v[:, 0])[0, 1], abs=1e-4)
    assert canonical_correlation(2.0 * x - 5.0, y @ np.diag([3.0, -1.0, 0.1])) == pytest.approx(
        ours
    )
    assert canonical_correlation(x, np.zeros((400, 1))) == 0.0


def nods(lag, n=20, n_frames=200):
    """A head whose speed is the loudness `lag` frames ago."""
    rng = np.random.default_rng(1)
    prosody, poses = [], []
    for _ in range(n):
        loud = np.abs(sway(n_frames + lag, rng))
        pose = np.zeros((n_frames, 3))
        pose[1:, 0] = np.cumsum(loud[1:n_frames]) / 25.0
        heard = np.zeros((n_frames, 2))
        heard[:, 1] = loud[lag : lag + n_frames] if lag else loud[:n_frames]
        prosody.append(heard)
        poses.append(pose)
    return prosody, poses


@pytest.mark.parametrize("lag", [0, 3])
def test_the_lag_of_a_head_behind_its_voice_is_found(lag):
    lag_s, r = head_lag_s(*nods(lag))

    assert lag_s == pytest.approx(lag / 25.0)
    assert r > 0.99


def test_a_head_that_follows_is_told_from_one_that_does_not():
    prosody, poses = nods(2)

    assert head_correlation(prosody, poses) > 0.95
    assert head_correlation([*prosody[1:], prosody[0]], poses) < 0.3


def test_spectra_differ_by_the_gain_in_decibels():
    rng = np.random.default_rng(0)
    poses = [np.stack([sway(200, rng) for _ in range(3)], axis=1) for _ in range(5)]

    assert log_psd_distance_db(poses, poses) == pytest.approx(0.0, abs=1e-9)
    assert log_psd_distance_db([2.0 * p for p in poses], poses) == pytest.approx(6.02, abs=0.05)
