"""Equation (3), its pointers back, and the back-off."""

from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lipsync.offline.line_synthesis import Candidates, cheapest_path


def candidates_of(table):
    """Return a function of a frame that returns its candidate states, with their distances.

    table: (n_frames, n_states) distances, inf where a state is in no unit.
    """

    def candidates(frame):
        states = np.flatnonzero(np.isfinite(table[frame]))
        return Candidates(states, table[frame][states])

    return candidates


def no_more(_frame):
    return None


@given(st.integers(0, 2**32 - 1))
def test_it_is_what_trying_every_path_finds(seed):
    rng = np.random.default_rng(seed)
    n_frames, n_states = rng.integers(1, 6), rng.integers(1, 5)
    table = rng.integers(0, 9, (n_frames, n_states)) + 1.0
    table[rng.random(table.shape) < 0.2] = np.inf
    table[:, 0] = 20.0  # one way through there always is
    follows = rng.random((n_states, n_states)) < 0.5
    follows[0, 0] = True
    costs = {
        way: sum(table[t, k] for t, k in enumerate(way))
        for way in product(range(n_states), repeat=int(n_frames))
        if all(follows[a, b] for a, b in pairwise(way))
    }

    path = cheapest_path(int(n_frames), candidates_of(table), follows, no_more)

    assert path.n_breaks == 0
    assert path.cost == pytest.approx(min(costs.values()))
    assert costs[tuple(path.states.tolist())] == pytest.approx(path.cost)


def test_where_no_state_can_be_reached_units_are_added_until_the_path_gets_through():
    follows = np.zeros((3, 3), dtype=bool)
    follows[0, 1] = follows[1, 2] = True
    table = np.array([[1.0, np.inf, np.inf], [1.0, np.inf, np.inf], [np.inf, np.inf, 1.0]])
    asked = []

    def widen(frame):
        asked.append(frame)
        if len(asked) == 2:
            table[1, 1] = 5.0  # the second unit that is added holds the missing link
        return 0

    path = cheapest_path(3, candidates_of(table), follows, widen)

    assert asked == [1, 1]
    assert path.states.tolist() == [0, 1, 2]
    assert path.cost == 7.0
    assert (path.n_widened, path.n_breaks) == (2, 0)


def test_without_any_way_through_the_path_begins_anew_and_says_so():
    table = np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]])

    path = cheapest_path(3, candidates_of(table), np.zeros((2, 2), dtype=bool), no_more)

    assert path.states.tolist() == [0, 0, 0]
    assert path.cost == 9.0
    assert path.n_breaks == 2
