"""Equation (4): the block-banded solve against a dense one, and what it means."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lipsync.offline.line_synthesis import banded, likeliest_trajectory


def positions_and_speeds(n, p):
    """Return the matrix W (2 p n, p n) from positions x_t to (x_t, x_{t+1} - x_t), frame by frame.

    The speed of the last frame is that of the frame before.
    """
    w = np.zeros((n, 2 * p, n, p))
    for t in range(n):
        w[t, :p, t] = np.eye(p)
        if n > 1:
            later = min(t + 1, n - 1)
            w[t, p:, later] += np.eye(p)
            w[t, p:, later - 1] -= np.eye(p)
    return w.reshape(2 * p * n, n * p)


def random_states(seed):
    rng = np.random.default_rng(seed)
    n, p = int(rng.integers(1, 7)), int(rng.integers(1, 4))
    factors = rng.normal(size=(n, 2 * p, 2 * p))
    covariances = factors @ factors.transpose(0, 2, 1) + 0.1 * np.eye(2 * p)
    return rng.normal(size=(n, 2 * p)), covariances


def test_two_frames_worked_by_hand():
    """Means 0 and 4, speeds 1 and 1, all variances 1: minimise
    a^2 + (b - 4)^2 + 2 (b - a - 1)^2. Slopes: 3 a - 2 b = -2, -2 a + 3 b = 6: a = 1.2, b = 2.8.
    """
    means = np.array([[0.0, 1.0], [4.0, 1.0]])

    found = likeliest_trajectory(means, np.repeat(np.eye(2)[None], 2, axis=0))

    assert found == pytest.approx(np.array([[1.2], [2.8]]))


@given(st.integers(0, 2**32 - 1))
def test_it_is_the_dense_solution(seed):
    means, covariances = random_states(seed)
    n, p = len(means), means.shape[1] // 2
    w = positions_and_speeds(n, p)
    precision = np.zeros((n, 2 * p, n, 2 * p))
    for t in range(n):
        precision[t, :, t] = np.linalg.inv(covariances[t])
    precision = precision.reshape(2 * p * n, 2 * p * n)
    if n == 1:  # no speed is known of a single frame; the solve leaves it out
        precision = np.zeros_like(precision)
        precision[:p, :p] = np.linalg.inv(covariances[0])[:p, :p]
        wanted = means[0, :p] + np.linalg.solve(
            precision[:p, :p], np.linalg.inv(covariances[0])[:p, p:] @ means[0, p:]
        )
    else:
        wanted = np.linalg.solve(w.T @ precision @ w, w.T @ precision @ means.ravel())

    found = likeliest_trajectory(means, np.linalg.inv(covariances))

    assert found.ravel() == pytest.approx(wanted, abs=1e-8)


def test_what_else_is_known_of_a_position_is_one_more_gaussian():
    """One frame at 0 and expected at 3, twice as surely: (0 + 2 * 3) / 3 = 2."""
    found = likeliest_trajectory(
        np.array([[0.0, 0.0]]), np.eye(2)[None], np.array([[3.0]]), np.array([[2.0]])
    )

    assert found == pytest.approx(np.array([[2.0]]))


def test_bands_hold_the_blocks():
    diagonal = np.array([[[1.0, 2.0], [2.0, 3.0]], [[4.0, 5.0], [5.0, 6.0]]])
    below = np.array([[[7.0, 8.0], [9.0, 10.0]]])
    whole = np.zeros((4, 4))
    whole[:2, :2], whole[2:, 2:] = diagonal
    whole[2:, :2], whole[:2, 2:] = below[0], below[0].T

    bands = banded(diagonal, below)

    for offset, band in enumerate(bands):
        assert band[: 4 - offset].tolist() == np.diagonal(whole, -offset).tolist()
