"""Lips that must touch do touch, by the likeliest and smallest change of the face."""

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from lipservo_lab.learning.motion.trained_model import load_trained_model
from small_model import small_model

from lipsync.motion.finishing import lip_gap_of


@given(st.lists(st.floats(-40.0, 40.0), min_size=8, max_size=8), st.floats(0.3, 3.0))
def test_a_full_amount_brings_any_face_within_the_distance(face, distance_mm):
    for model in (small_model(), load_trained_model()):
        narrowed = lip_gap_of(model).narrowed(
            np.array(face[: model.n_components]), distance_mm, 1.0
        )
        assert model.lip_gap_mm(narrowed) <= distance_mm + 1e-3


def test_no_amount_leaves_the_face_alone():
    face = np.array([10.0, 2.0, -3.0, 1.0, 0.0])
    assert lip_gap_of(small_model()).narrowed(face, 0.5, 0.0) is face


def test_the_face_moves_as_its_covariance_says():
    """On a diagonal covariance the opening takes up the change, not the lips' own components."""
    model = small_model()
    wide = model.rest + np.array([30.0, 0.0, 0.0, 0.0, 0.0])
    change = lip_gap_of(model).narrowed(wide, 0.5, 1.0) - wide
    assert abs(change[0]) > 5 * np.abs(change[1:]).max()


def test_the_correction_is_smooth_where_it_sets_in():
    model = small_model()
    gap = lip_gap_of(model)
    openings = np.linspace(0.0, 6.0, 600)
    faces = [gap.narrowed(model.rest + np.array([o, 0, 0, 0, 0]), 1.0, 1.0)[0] for o in openings]
    slopes = np.diff(faces) / np.diff(openings)
    assert np.abs(np.diff(slopes)).max() < 0.05
    assert math.isfinite(slopes.sum())
