"""States of the mouth: clusters of the manifold, which follows which, and what each looks like.

Edge, Hilton and Jackson, steps 4 and 5 and the Gaussians of step 6.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from sklearn.cluster import BisectingKMeans

from lipsync.arrays import Array, Indices


def bisected_states(coordinates: Array, n_states: int, seed: int) -> Indices:
    """The state of each frame, (n,), by bisecting k-means on the manifold (n, d), equation (S1).

    The cluster with the largest squared error is split in two until there are `n_states`
    (Steinbach, Karypis and Kumar, "A comparison of document clustering techniques", 2000).
    """
    kmeans = BisectingKMeans(n_states, random_state=seed, n_init=1)
    return np.asarray(kmeans.fit_predict(coordinates), dtype=np.int64)


def transitions(sentences: Sequence[Indices], n_states: int) -> NDArray[np.bool_]:
    """T (n_states, n_states), equation (S2): whether a frame in i is anywhere followed by one in j.

    sentences: the states of each sentence in order of time. Binary on purpose: what was seen once
    is as possible as what is common.
    """
    follows = np.zeros((n_states, n_states), dtype=np.bool_)
    for states in sentences:
        follows[states[:-1], states[1:]] = True
    return follows


def state_gaussians(
    positions: Array, speeds: Array, states: Indices, n_states: int, shrinkage: float
) -> tuple[Array, Array]:
    """Means (n_states, 2 p) and covariances (n_states, 2 p, 2 p) of y = (x, x'), equation (S3).

    positions, speeds: (n, p). A state of a few frames cannot tell a covariance of 2 p numbers: it
    is drawn to the mean one of all states as if `shrinkage` frames of that had been seen as well.
    """
    both = np.concatenate([positions, speeds], axis=1)
    counts = np.bincount(states, minlength=n_states).astype(np.float64)
    means = np.zeros((n_states, both.shape[1]))
    np.add.at(means, states, both)
    means /= np.maximum(counts, 1.0)[:, None]
    rest = both - means[states]
    within = rest.T @ rest / len(both)
    floor = 1e-6 * max(float(np.trace(within)) / len(within), 1e-12) * np.eye(len(within))
    scatter = np.zeros((n_states, both.shape[1], both.shape[1]))
    for state in range(n_states):
        mine = rest[states == state]
        scatter[state] = mine.T @ mine
    weights = (counts + shrinkage)[:, None, None]
    return means, (scatter + shrinkage * (within + floor)) / weights + floor
