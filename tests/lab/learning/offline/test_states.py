"""Bisecting k-means, binary transitions, and the Gaussian of each state."""

import numpy as np
import pytest
from lipservo_lab.learning.offline.state_training import (
    bisected_states,
    state_gaussians,
    transitions,
)


def test_well_parted_clusters_become_the_states():
    rng = np.random.default_rng(0)
    centres = np.array([[0.0, 0.0], [10.0, 0.0], [0.0, 10.0], [10.0, 10.0]])
    which = rng.integers(0, 4, 200)
    frames = centres[which] + rng.normal(0, 0.3, (200, 2))

    states = bisected_states(frames, 4, seed=0)

    assert len(set(zip(which.tolist(), states.tolist(), strict=True))) == 4


def test_the_first_cut_halves_what_spreads_most():
    frames = np.array([[0.0], [1.0], [100.0], [101.0]])

    states = bisected_states(frames, 2, seed=0)

    assert states[0] == states[1] != states[2] == states[3]


def test_a_transition_is_there_or_not_however_often_and_never_between_sentences():
    follows = transitions([np.array([0, 0, 1, 0, 0]), np.array([2, 1])], 3)

    assert follows.tolist() == [
        [True, True, False],
        [True, False, False],
        [False, True, False],
    ]


def test_a_state_has_the_mean_and_covariance_of_its_positions_and_speeds():
    positions = np.array([[0.0], [2.0], [9.0]])
    speeds = np.array([[1.0], [3.0], [5.0]])

    means, covariances = state_gaussians(positions, speeds, np.array([0, 0, 1]), 2, 0.0)

    assert means.tolist() == [[1.0, 2.0], [9.0, 5.0]]
    assert covariances[0] == pytest.approx(np.ones((2, 2)), abs=1e-5)


def test_a_rare_state_is_drawn_to_the_covariance_of_all():
    """State 1 was seen once and has no spread: 2 frames of the mean one make it 2 / 3 of that."""
    positions = np.array([[0.0], [2.0], [9.0]])
    within = 2.0 / 3.0  # squares 1 and 1 and 0 over three frames

    _, covariances = state_gaussians(positions, np.zeros((3, 1)), np.array([0, 0, 1]), 2, 2.0)

    assert covariances[1][0, 0] == pytest.approx(within * 2.0 / 3.0, rel=1e-5)
    assert covariances[0][0, 0] == pytest.approx((2.0 + 2.0 * within) / 4.0, rel=1e-5)
    assert np.linalg.eigvalsh(covariances).min() > 0.0
