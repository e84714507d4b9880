"""The embedding by distances, and its form for long recordings against the exact one."""

import numpy as np
import pytest
from lipservo_lab.learning.offline.state_training import landmark_frames, speech_manifold
from scipy.spatial.distance import cdist, pdist
from sklearn.decomposition import PCA


def speech(n):
    """A mouth that opens and closes: position and speed on ellipses of changing size."""
    rng = np.random.default_rng(0)
    angle, size = np.cumsum(rng.uniform(0.2, 0.6, n)), 1.0 + np.cumsum(rng.normal(0, 0.05, n))
    ellipses = np.stack([size * np.cos(angle), 0.5 * size * np.sin(angle)], axis=1)
    return np.concatenate([ellipses, rng.normal(0, 0.1, (n, 4))], axis=1)


def test_with_every_frame_a_landmark_it_is_pca_of_the_distance_matrix():
    z = speech(120)
    pca = PCA(n_components=0.99, svd_solver="full").fit(cdist(z, z))

    found = speech_manifold(z, n_landmarks=None)

    assert found.shape[1] == pca.n_components_
    assert pdist(found) * np.sqrt(120) == pytest.approx(pdist(pca.transform(cdist(z, z))), rel=1e-4)


def test_landmarks_lay_the_frames_out_as_the_exact_form_does():
    z = speech(600)

    exact, by_landmarks = speech_manifold(z, None), speech_manifold(z, 100)

    assert abs(exact.shape[1] - by_landmarks.shape[1]) <= 1
    assert np.corrcoef(pdist(exact[::3]), pdist(by_landmarks[::3]))[0, 1] > 0.999


def test_landmarks_lie_evenly_from_the_first_frame_to_the_last():
    assert landmark_frames(9, 5).tolist() == [0, 2, 4, 6, 8]
    assert landmark_frames(3, 5).tolist() == [0, 1, 2]
