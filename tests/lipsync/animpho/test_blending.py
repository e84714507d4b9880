"""Equations (3) to (5) and Algorithm 1 of Wei and Deng, against numbers worked out by hand."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from small_model import small_model

from lipsync.animpho.trajectory import (
    Trajectory,
    blend,
    choose_connected,
    ease,
    sample_derivatives,
    translate,
)
from lipsync.animpho.units import IndexLists


def column(*values: float) -> np.ndarray:
    return np.array(values, dtype=float)[:, None]


def test_equation_3_takes_the_successor_that_moves_most_like_the_chosen_one():
    """Distances over all samples: 5 * 3^2 = 45 for AnimPho 1, 4^2 = 16 for AnimPho 2."""
    animphos = np.zeros((4, 5, 5))
    animphos[1] = 0.0
    animphos[1, :, 0] = 3.0
    animphos[2, 4, 0] = 4.0
    units = replace(
        small_model().animphos,
        samples=animphos,
        successors=IndexLists.from_pairs(np.array([0, 0]), np.array([1, 2]), 4),
    )
    assert choose_connected(units, previous=0, chosen=3) == 2
    assert choose_connected(units, previous=0, chosen=1) == 1, "a_t itself when it follows"
    assert choose_connected(units, previous=3, chosen=1) == 1, "nothing follows: a_t itself"


def test_translation_lays_the_first_frame_on_the_last_one_shown():
    laid = translate(column(2, 4, 6, 8, 9), np.array([10.0]))
    assert laid.ravel().tolist() == [10, 12, 14, 16, 17]


def test_equation_4_blends_from_the_connected_one_to_the_chosen_one():
    """By hand: 0, 3/4*4 + 1/4*8, 1/2*8 + 1/2*8, 1/4*12 + 3/4*8, 8."""
    blended = blend(column(0, 4, 8, 12, 16), column(8, 8, 8, 8, 8))
    assert blended.ravel().tolist() == [0, 5, 8, 9, 8]


def test_equation_5_keeps_the_first_derivative_and_takes_central_differences():
    derivatives = sample_derivatives(column(0, 1, 4, 9, 16), np.array([0.5]))
    assert derivatives.ravel().tolist() == [0.5, 2, 4, 6, 7]


def test_hermite_interpolation_agrees_with_scipy():
    rng = np.random.default_rng(1)
    samples, derivatives = rng.normal(size=(2, 5, 3))
    trajectory = Trajectory(2.0, 0.2, samples, derivatives)
    spline = CubicHermiteSpline(2.0 + 0.05 * np.arange(5), samples, derivatives / 0.05)
    for time_s in np.linspace(2.0, 2.2, 41):
        position, velocity = trajectory.at(time_s)
        np.testing.assert_allclose(position, spline(time_s), atol=1e-12)
        np.testing.assert_allclose(velocity, spline(time_s, 1), atol=1e-10)


def test_a_trajectory_rests_at_its_last_sample_afterwards():
    trajectory = Trajectory(0.0, 0.1, column(0, 1, 2, 3, 7), column(1, 1, 1, 1, 4))
    position, velocity = trajectory.at(5.0)
    assert (position[0], velocity[0]) == (7.0, 0.0)


def test_easing_starts_as_it_moved_and_ends_at_rest():
    curve = ease(1.0, 0.25, np.array([2.0]), np.array([8.0]), np.array([-1.0]))
    assert [v[0] for v in curve.at(1.0)] == pytest.approx([2.0, 8.0])
    assert [v[0] for v in curve.at(1.25)] == pytest.approx([-1.0, 0.0])
