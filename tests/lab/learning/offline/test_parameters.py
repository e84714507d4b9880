"""Principal components, speeds, and the one scale of each block."""

import numpy as np
import pytest
from lipservo_lab.learning.offline.state_training import (
    find_components,
    joint_parameters,
    velocities,
)


def em_pca(frames, n_components, n_rounds):
    """Roweis, "EM Algorithms for PCA and SPCA", 1997, section 3.1: the space of the components."""
    y = (frames - frames.mean(axis=0)).T
    c = np.random.default_rng(0).normal(size=(len(y), n_components))
    for _ in range(n_rounds):
        x = np.linalg.solve(c.T @ c, c.T @ y)
        c = y @ x.T @ np.linalg.inv(x @ x.T)
    return np.linalg.qr(c)[0]


def test_the_components_span_what_em_finds():
    rng = np.random.default_rng(1)
    frames = rng.normal(size=(300, 12)) * [9, 7, 5, 1, 1, 1, 1, 1, 1, 1, 1, 1] + 3.0
    by_em = em_pca(frames, 3, 200)

    components = find_components([frames[:100], frames[100:]], 3)

    cosines = np.linalg.svd(components.basis @ by_em, compute_uv=False)
    assert cosines == pytest.approx(np.ones(3), abs=1e-6)
    assert components.of(frames).mean(axis=0) == pytest.approx(np.zeros(3), abs=1e-9)
    assert 0.9 < components.share < 1.0


def test_a_speed_is_the_step_to_the_next_frame_and_the_last_keeps_the_one_before():
    assert velocities(np.array([[1.0], [4.0], [6.0]])).tolist() == [[3.0], [2.0], [2.0]]
    assert velocities(np.array([[1.0]])).tolist() == [[0.0]]


def test_each_block_has_variance_one_and_keeps_its_proportions():
    rng = np.random.default_rng(2)
    sentences = [rng.normal(size=(40, 2)) * [8.0, 2.0] for _ in range(3)]

    z = joint_parameters(sentences)

    assert z[:, :2].var(axis=0).sum() == pytest.approx(1.0)
    assert z[:, 2:].var(axis=0).sum() == pytest.approx(1.0)
    assert z[:, 0].std() / z[:, 1].std() == pytest.approx(4.0, rel=0.2)


def test_no_speed_leads_from_one_sentence_into_the_next():
    z = joint_parameters([np.array([[0.0], [1.0]]), np.array([[100.0], [101.0]])])

    assert z[:, 1] == pytest.approx(np.full(4, 1.0))  # four steps of 1, no variance to scale


def test_em_of_dense_scans_finds_the_components_of_a_full_decomposition():
    """2,000 points: the covariance would take 288 MB."""
    rng = np.random.default_rng(3)
    modes = rng.normal(size=(30, 6000))
    frames = (rng.normal(size=(120, 30)) * 0.8 ** np.arange(30)) @ modes + 40.0
    sentences = [frames[:50].astype(np.float32), frames[50:].astype(np.float32)]
    _, values, exact = np.linalg.svd(frames - frames.mean(axis=0), full_matrices=False)

    components = find_components(sentences, 8)

    assert np.abs(np.diag(components.basis @ exact[:8].T)) == pytest.approx(np.ones(8), abs=1e-5)
    assert components.basis @ components.basis.T == pytest.approx(np.eye(8), abs=1e-9)
    assert components.share == pytest.approx((values[:8] ** 2).sum() / (values**2).sum(), rel=1e-5)
    assert components.mean_mm == pytest.approx(frames.mean(axis=0), abs=1e-4)
