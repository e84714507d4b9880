"""Closing lips: when it is planned, and that they do touch."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from small_model import small_model
from spoken_phonemes import spoken

from lipsync.expectation.context import track_of
from lipsync.motion.closure_plan import CLOSING_S, OPEN, Amount, planned
from lipsync.motion.lip_closure import lip_gap_of
from lipsync.phonemes import PHONEMES
from lipsync.training.trained_model import load_trained_model

M = {PHONEMES.index("M"): 0.03}
TICK_S = 0.01


def amounts(events, lookahead_s: float, until_s: float) -> dict[float, float]:
    """The smooth amount at every 10 ms."""
    track, now, found = track_of(events), OPEN, {}
    for tick in range(round(until_s / TICK_S)):
        time_s = tick * TICK_S
        now = planned(now, M, track, time_s, time_s + lookahead_s)
        found[round(time_s, 3)] = now.smooth(time_s)
    return found


def test_lips_are_shut_at_the_tightest_moment_and_open_again_after_the_phone():
    found = amounts(spoken(("AA", 0.5), ("M", 0.08), ("AA", 0.5)), 0.1, 1.0)
    assert found[0.53] == 1.0
    assert found[0.45] == 0.0
    assert found[0.60] == 0.0


def test_without_look_ahead_they_shut_as_soon_as_the_phone_is_heard():
    found = amounts(spoken(("AA", 0.5), ("M", 0.08), ("AA", 0.5)), 0.0, 1.0)
    assert found[0.50] == 0.0
    assert max(found[round(0.5 + k * TICK_S, 3)] for k in range(8)) == 1.0


def test_a_closure_once_begun_is_completed_even_when_the_phone_is_over():
    found = amounts(spoken(("AA", 0.5), ("M", 0.02), ("AA", 0.5)), 0.0, 1.0)
    assert max(found.values()) == 1.0


def test_the_second_of_two_labials_is_not_held_to_its_end_as_if_heard_of_late():
    found = amounts(spoken(("AA", 0.5), ("M", 0.05), ("M", 0.2), ("AA", 0.5)), 0.1, 1.0)
    assert found[0.58] == 1.0  # its own tightest moment
    assert found[0.70] == 0.0


def test_without_a_labial_nothing_closes():
    assert not any(amounts(spoken(("AA", 0.5), ("F", 0.2), ("AA", 0.5)), 0.1, 1.0).values())


@given(st.floats(0.0, 1.0), st.floats(-40.0, 40.0), st.sampled_from([0.0, 1.0]))
def test_an_amount_starts_where_the_last_one_was_and_ends_at_its_goal(value, slope, goal):
    amount = Amount(2.0, CLOSING_S, value, slope, goal)
    assert amount.at(2.0) == pytest.approx((value, slope))
    assert amount.at(2.0 + CLOSING_S) == (goal, 0.0)
    nearly = amount.at(2.0 + CLOSING_S - 1e-9)
    assert nearly == pytest.approx((goal, 0.0), abs=1e-3)


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
