"""Equation (2): windows of sound, weighted by a Gaussian, and the nearest frame of each state."""

import numpy as np
import pytest

from lipsync.offline.line_synthesis import (
    Window,
    gaussian_window,
    nearest_of_each_state,
    unit_distances,
)


def test_a_window_is_a_gaussian_of_three_deviations_that_adds_up_to_one():
    window = gaussian_window(0.04, 25.0)

    assert window.offsets.tolist() == [-3, -2, -1, 0, 1, 2, 3]
    assert window.weights.sum() == pytest.approx(1.0)
    assert window.weights[4] / window.weights[3] == pytest.approx(np.exp(-0.5))
    assert window.weights[6] / window.weights[3] == pytest.approx(np.exp(-4.5))


def test_the_distance_of_two_windows_worked_by_hand():
    """Weights 1/4 1/2 1/4; cepstra 1 2 3 against 1 0 0: (1/4) 0 + (1/2) 4 + (1/4) 9 = 4.25."""
    window = Window(np.array([-1, 0, 1]), np.array([0.25, 0.5, 0.25]))
    heard = window.of(np.array([[1.0], [2.0], [3.0]]), np.array([1]), (0, 3))
    stored = window.of(np.array([[1.0], [0.0], [0.0]]), np.array([1]), (0, 3))

    assert unit_distances(heard, stored) == pytest.approx(np.sqrt([[4.25]]))


def test_a_window_does_not_reach_into_the_next_recording():
    window = Window(np.array([-1, 0, 1]), np.array([1.0, 1.0, 1.0]))
    cepstra = np.arange(6.0)[:, None]

    assert window.of(cepstra, np.array([2, 3]), (2, 4)).tolist() == [[2, 2, 3], [2, 3, 3]]


def test_each_state_takes_its_nearest_frame_and_those_in_no_unit_are_left_out():
    found = nearest_of_each_state(
        [np.array([7, 2, 7]), np.array([2])], [np.array([3.0, 5.0, 1.0]), np.array([4.0])]
    )

    assert found.states.tolist() == [2, 7]
    assert found.distances.tolist() == [4.0, 1.0]
