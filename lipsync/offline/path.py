"""The cheapest way through the states of a line: Viterbi's recursion on distances.

Edge, Hilton and Jackson, steps 4 and 5 of synthesis.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array, Indices
from lipsync.offline.state_distances import Candidates

Follows = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Path:
    """states: (n,), one a frame. cost: D at the end.

    n_widened: how often units were added; n_breaks: frames that no transition leads to, even with
    all units, and which were begun anew.
    """

    states: Indices
    cost: float
    n_widened: int
    n_breaks: int


@dataclass(frozen=True, slots=True)
class _Step:
    """One frame: its states, the least cost to be in each, and where it came from."""

    states: Indices
    costs: Array
    back: Indices


def cheapest_path(
    n_frames: int,
    candidates: Callable[[int], Candidates],
    follows: Follows,
    widen: Callable[[int], int | None],
) -> Path:
    """The path of least total distance whose every step was seen in the recordings.

    D(t, k) = dist(t, k) + min over j with T(j, k) = 1 of D(t-1, j), equation (3), with a pointer
    back to the best j.

    candidates: of a frame, as known now. follows: T. widen: called where every D(t, .) is infinite;
    adds the next most similar unit of the left and of the right context (2, 4, 6 ... units) and
    says from which frame on candidates are changed, None where no unit is left.
    """
    steps: list[_Step] = []
    n_widened, breaks = 0, set()
    while len(steps) < n_frames:
        t = len(steps)
        step = _advanced(steps[-1] if steps else None, candidates(t), follows)
        if step is None and t not in breaks:
            changed = widen(t)
            if changed is not None:
                n_widened += 1
                del steps[changed:]
                continue
            breaks.add(t)
        if step is None:
            step = _begun_anew(steps[-1], candidates(t))
        steps.append(step)
    at = int(np.argmin(steps[-1].costs))
    cost = float(steps[-1].costs[at])
    states = np.zeros(n_frames, dtype=np.int64)
    for t in range(n_frames - 1, -1, -1):
        states[t] = steps[t].states[at]
        at = int(steps[t].back[at])
    return Path(states, cost, n_widened, len(breaks))


def _advanced(before: _Step | None, now: Candidates, follows: Follows) -> _Step | None:
    """Equation (3) for one frame; None where every state is infinitely far."""
    if before is None:
        start = np.zeros(len(now.states), dtype=np.int64)
        return _Step(now.states, now.distances, start)
    allowed = follows[before.states[:, None], now.states]
    costs = np.where(allowed, before.costs[:, None], np.inf)
    back = costs.argmin(axis=0)
    least = costs[back, np.arange(len(back))]
    reached = np.isfinite(least)
    if not reached.any():
        return None
    return _Step(now.states[reached], (now.distances + least)[reached], back[reached])


def _begun_anew(before: _Step, now: Candidates) -> _Step:
    """As if every state could follow the best one so far."""
    best = int(before.costs.argmin())
    back = np.full(len(now.states), best, dtype=np.int64)
    return _Step(now.states, now.distances + before.costs[best], back)
