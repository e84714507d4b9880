"""Motion of a line from its sound and phones, by the method of Edge, Hilton and Jackson.

The steps are numbered as in their paper. Step 2 finds the stored units (pieces of the recordings)
that sound most like a stretch of the line. A unit runs from the centre of the phone before to the
centre of the phone after, and is classified by the phone in its middle alone. Dynamic time warping
is dtaidistance's. Step 3 is the distance of each state from a frame: the Euclidean distance of two
windows of cepstra, each frame weighted by a Gaussian around the middle. Steps 4 and 5 are the
cheapest path through the states, Viterbi's recursion on distances. Step 6 is the likeliest motion
through them, one block-banded linear system, after Brand, "Voice puppetry", SIGGRAPH 1999.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solveh_banded
from scipy.spatial.distance import cdist

from lipsync.arrays import Array, Indices
from lipsync.offline.offline_model import StateModel
from lipsync.phonemes import PHONEMES, PhonemeEvent, stand_in


@dataclass(frozen=True, slots=True)
class Spans:
    """The units (stretches of sound) of one recording, one a phone: frames first_i <= f < end_i.

    A unit runs from the centre of the phone before to the centre of the phone after. centres_s: of
    each unit the centre of its own phone, in seconds.
    """

    phonemes: tuple[str, ...]
    first: Indices
    end: Indices
    centres_s: Array

    def neighbours(self, n_frames: int, frame_rate_hz: float) -> tuple[Indices, Indices]:
        """Return for each of `n_frames` frames the numbers of the units to its left and its right.

        These are the units with the nearest phone centre not after the frame, and after the frame,
        (n_frames,) each; before the first centre, and after the last, both are the same unit.
        """
        times_s = np.arange(n_frames) / frame_rate_hz
        next_unit = np.searchsorted(self.centres_s, times_s + 1e-9)
        last = len(self.phonemes) - 1
        return np.clip(next_unit - 1, 0, last), np.clip(next_unit, 0, last)


def unit_spans(events: Sequence[PhonemeEvent], n_frames: int, frame_rate_hz: float) -> Spans:
    """Return the units of a recording of `n_frames` frames, one for each phone of `events`.

    The phones follow each other without gaps. The first unit begins with the recording, the last
    ends with it; each has one frame at least.
    """
    duration_s = n_frames / frame_rate_hz
    ends_s = [duration_s if e.end_s is None else e.end_s for e in events]
    centres_s = np.array([(e.start_s + end) / 2.0 for e, end in zip(events, ends_s, strict=True)])
    # The first frame not before each phone's centre.
    borders = np.ceil(centres_s * frame_rate_hz - 1e-6).astype(np.int64)
    first = np.concatenate([[0], borders[:-1]])
    end = np.concatenate([borders[1:], [n_frames]])
    first = np.clip(first, 0, n_frames - 1)
    return Spans(
        tuple(e.phoneme for e in events), first, np.clip(end, first + 1, n_frames), centres_s
    )


def warped_distances(target: Array, stored: Sequence[Array]) -> Array:
    """Return each stored unit's distance in sound from the target, by dynamic time warping.

    P(i, j) = d(i, j) + min(P(i-1, j), P(i-1, j-1), P(i, j-1)), equation (1), with d the Euclidean
    distance of cepstra; the cost of a unit is P at the ends of both. Needs the extra `offline`.

    Parameters
    ----------
    target : Array
        (n, m) cepstra of the line's phone.
    stored : Sequence[Array]
        (n_j, m) cepstra of each stored unit (piece of a recording).

    Returns
    -------
    Array
        (n_units,) distances, 0 or more.
    """
    from dtaidistance.dtw_cc import distance_ndim  # the published method alone needs it

    target = np.ascontiguousarray(target, dtype=np.float64)
    return np.array([distance_ndim(target, each, inner_dist="euclidean") for each in stored])


def joined_phones(events: Sequence[PhonemeEvent], duration_s: float) -> tuple[PhonemeEvent, ...]:
    """Return the phones of a line end to end from 0 to `duration_s`, with silence in all gaps.

    A phone that begins after `duration_s` is left out; one that goes on beyond it is cut there.
    """
    joined: list[PhonemeEvent] = []

    def add_phone(phoneme: str, start_s: float, end_s: float) -> None:
        if joined and phoneme == "SIL" == joined[-1].phoneme:
            joined[-1] = PhonemeEvent("SIL", joined[-1].start_s, end_s)
        elif end_s > start_s:
            joined.append(PhonemeEvent(phoneme, start_s, end_s))

    reached_s = 0.0
    for event in events:
        end_s = duration_s if event.end_s is None else min(event.end_s, duration_s)
        if end_s <= event.start_s:
            continue
        if event.start_s > reached_s:
            add_phone("SIL", reached_s, event.start_s)
        add_phone(event.phoneme, event.start_s, end_s)
        reached_s = end_s
    if reached_s < duration_s:
        add_phone("SIL", reached_s, duration_s)
    return tuple(joined)


def frames_between(borders: Indices) -> list[range]:
    """Return each recording's range of frames; `borders` (n + 1,): first frames, and the end."""
    return [range(int(a), int(b)) for a, b in pairwise(borders)]


@dataclass(frozen=True, slots=True)
class Window:
    """A weighted window: offsets (w,) in frames around its middle, weights (w,) that sum to 1."""

    offsets: Indices
    weights: Array

    def of(self, cepstra: NDArray[np.floating], frames: Indices, borders: tuple[int, int]) -> Array:
        """Return the window of cepstra around each frame, scaled for the distance of equation (2).

        Parameters
        ----------
        cepstra : NDArray[np.floating]
            (n_frames, m).
        frames : Indices
            (n,) numbers of the frames in the middle.
        borders : tuple[int, int]
            First frame of the recording, and the one after its last; beyond them its ends are
            repeated.

        Returns
        -------
        Array
            (n, w m), each value multiplied by the root of its frame's weight.
        """
        first, end = borders
        # Beyond the recording its first or last frame is repeated.
        in_window = np.clip(frames[:, None] + self.offsets, first, end - 1)
        weighted = cepstra[in_window] * np.sqrt(self.weights)[:, None]
        return np.asarray(weighted.reshape(len(frames), -1))


def gaussian_window(deviation_s: float, frame_rate_hz: float) -> Window:
    """Return a Gaussian window of three standard deviations, `deviation_s` each, to both sides."""
    deviation = deviation_s * frame_rate_hz
    reach = int(np.ceil(3.0 * deviation))
    offsets = np.arange(-reach, reach + 1)
    weights = np.exp(-0.5 * (offsets / max(deviation, 1e-9)) ** 2)
    return Window(offsets, weights / weights.sum())


@dataclass(frozen=True, slots=True)
class Candidates:
    """The states (n,) that a frame may be in, each once, and its distances (n,) from the states."""

    states: Indices
    distances: Array


def unit_distances(heard: Array, stored: Array) -> Array:
    """Return the distance of each window of cepstra of a line from each window of a stored unit.

    Equation (2): dist(t, f) = sqrt( sum_w g(w) || c(t + w) - c'(f + w) ||^2 ); the windows contain
    the weights g already.

    Parameters
    ----------
    heard : Array
        (n, w m), of `Window.of`.
    stored : Array
        (n_j, w m), of `Window.of`.

    Returns
    -------
    Array
        (n, n_j).
    """
    return np.asarray(cdist(heard, stored), dtype=np.float64)


def nearest_of_each_state(states: Sequence[Indices], distances: Sequence[Array]) -> Candidates:
    """Return each state's least distance from one frame of a line, by equation (2).

    dist(t, k) = min of dist(t, f) over the units' frames f in state k. States that occur in no unit
    are left out.

    Parameters
    ----------
    states,distances : Sequence[Indices]
        (n_j,) for each unit: states of its frames, and their distances from the frame t.

    Returns
    -------
    Candidates
        The states found, (k,), and their distances, (k,).
    """
    all_states, all_distances = np.concatenate(states), np.concatenate(distances)
    # Sorted by state and, within a state, by distance: the first row of each state is its nearest.
    by_state = np.lexsort((all_distances, all_states))
    found, first = np.unique(all_states[by_state], return_index=True)
    return Candidates(found, all_distances[by_state][first])


Follows = NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Path:
    """A path through the states. states: (n,), one a frame. cost: its sum of distances, the last D.

    n_widened: how often stored units were added; n_breaks: number of frames that no transition
    leads to, even with all units, at which the path was begun anew.
    """

    states: Indices
    cost: float
    n_widened: int
    n_breaks: int


@dataclass(frozen=True, slots=True)
class _Step:
    """One frame of a path search: the states (k,) that can be reached, and their least costs (k,).

    back: (k,), from which state each is reached, as an index in the states of the frame before.
    """

    states: Indices
    costs: Array
    back: Indices


def cheapest_path(
    n_frames: int,
    candidates: Callable[[int], Candidates],
    follows: Follows,
    widen: Callable[[int], int | None],
) -> Path:
    """Return the path of least total distance whose every step was seen in the recordings.

    D(t, k) = dist(t, k) + min over j with T(j, k) = 1 of D(t-1, j), equation (3), with a pointer
    back to the best j.

    candidates: returns the states open to a frame at present, with its distances from them.
    follows: T. widen: called for a frame t where every D(t, .) is infinite; adds the next most
    similar stored unit of the left and of the right context (2, 4, 6 ... units) and returns the
    first frame whose candidates changed, None where no unit is left; then frame t may follow any
    state.
    """
    steps: list[_Step] = []
    n_widened, break_frames = 0, set()
    while len(steps) < n_frames:
        t = len(steps)
        step = _advance(steps[-1] if steps else None, candidates(t), follows)
        # No state can be reached: allow more units and search again from the first frame changed.
        if step is None and t not in break_frames:
            first_changed = widen(t)
            if first_changed is not None:
                n_widened += 1
                del steps[first_changed:]
                continue
            break_frames.add(t)
        if step is None:
            step = _restart_path(steps[-1], candidates(t))
        steps.append(step)
    # Back along the pointers from the cheapest last state.
    state_index = int(np.argmin(steps[-1].costs))
    cost = float(steps[-1].costs[state_index])
    states = np.zeros(n_frames, dtype=np.int64)
    for t in range(n_frames - 1, -1, -1):
        states[t] = steps[t].states[state_index]
        state_index = int(steps[t].back[state_index])
    return Path(states, cost, n_widened, len(break_frames))


def _advance(before: _Step | None, now: Candidates, follows: Follows) -> _Step | None:
    """Return the search step of one frame by equation (3); None where no state can be reached.

    before: the step of the frame before, None for the first frame; now: the frame's candidates.
    follows: whether the second state may follow the first, T of equation (3).
    """
    if before is None:
        return _Step(now.states, now.distances, np.zeros(len(now.states), dtype=np.int64))
    allowed = follows[before.states[:, None], now.states]
    costs = np.where(allowed, before.costs[:, None], np.inf)
    back = costs.argmin(axis=0)
    least_costs = costs[back, np.arange(len(back))]
    reached = np.isfinite(least_costs)
    if not reached.any():
        return None
    return _Step(now.states[reached], (now.distances + least_costs)[reached], back[reached])


def _restart_path(before: _Step, now: Candidates) -> _Step:
    """Return the search step of frame `now` as if every state could follow the best of `before`."""
    cheapest = int(before.costs.argmin())
    back = np.full(len(now.states), cheapest, dtype=np.int64)
    return _Step(now.states, now.distances + before.costs[cheapest], back)


def likeliest_trajectory(
    means: Array,
    precisions: Array,
    expected: Array | None = None,
    expected_precision: Array | None = None,
) -> Array:
    """Return the positions that maximise the product over t of N(y~_t; 0, K_t), equation (4).

    y~_t = (x_t, x_{t+1} - x_t) - mu_t; in the last frame the speed is that of the step before. With
    W the matrix that takes positions to positions and speeds: W' K^-1 W x = W' K^-1 mu, which is
    symmetric, positive definite, and p by p blocks around the diagonal.

    Parameters
    ----------
    means : Array
        (n, 2 p), mu_t of each frame's state.
    precisions : Array
        (n, 2 p, 2 p), the inverse of K_t.
    expected : Array | None
        (n, p), another estimate of each position, one more Gaussian a frame: not of the paper;
        None: without it.
    expected_precision : Array | None
        (p, p), the precision of that estimate in each frame.

    Returns
    -------
    Array
        (n, p) positions.
    """
    n, p = len(means), means.shape[1] // 2
    # The blocks of W' K^-1 W on and below the diagonal, and the right-hand side W' K^-1 mu.
    diagonal = np.zeros((n, p, p))
    below = np.zeros((max(n - 1, 0), p, p))
    right = np.zeros((n, p))
    # K^-1 in its four blocks, and K^-1 mu in its two.
    xx, xv, vv = precisions[:, :p, :p], precisions[:, :p, p:], precisions[:, p:, p:]
    weighted = np.einsum("tij,tj->ti", precisions, means)
    right_x, right_v = weighted[:, :p], weighted[:, p:]
    diagonal += xx
    right += right_x
    if n > 1:
        # Speeds from the frame to the next: x_t has -1 in them, x_{t+1} has 1.
        but_last = slice(0, n - 1)
        vx = xv.transpose(0, 2, 1)
        diagonal[:-1] += vv[but_last] - xv[but_last] - vx[but_last]
        diagonal[1:] += vv[but_last]
        below += vx[but_last] - vv[but_last]
        right[:-1] -= right_v[but_last]
        right[1:] += right_v[but_last]
        # The last frame's speed is from the frame before to it.
        diagonal[-1] += vv[-1] + xv[-1] + vx[-1]
        diagonal[-2] += vv[-1]
        below[-1] -= vv[-1] + xv[-1]
        right[-1] += right_v[-1]
        right[-2] -= right_v[-1]
    if expected is not None and expected_precision is not None:
        diagonal += expected_precision
        right += expected @ expected_precision
    if n == 1:
        return np.linalg.solve(diagonal[0], right[0])[None]
    solved = solveh_banded(banded(diagonal, below), right.ravel(), lower=True, check_finite=False)
    return np.asarray(solved, dtype=np.float64).reshape(n, p)


def banded(diagonal: Array, below: Array) -> Array:
    """Return the lower bands of a symmetric block-tridiagonal matrix, as `solveh_banded` expects.

    Parameters
    ----------
    diagonal : Array
        (n, p, p), the blocks on the diagonal.
    below : Array
        (n - 1, p, p), the blocks under it.

    Returns
    -------
    Array
        (2 p, n p): row d holds the entries d below the diagonal, by their column.
    """
    n, p = diagonal.shape[:2]
    bands = np.zeros((2 * p, n, p))
    for row in range(p):
        for column in range(p):
            if row >= column:
                bands[row - column, :, column] = diagonal[:, row, column]
            bands[p + row - column, : n - 1, column] = below[:, row, column]
    return bands.reshape(2 * p, n * p)


#: Standard deviation of the Gaussian around a frame in equation (2), s.
WINDOW_DEVIATION_S = 0.04


@dataclass(frozen=True, slots=True)
class ModelledLine:
    """Motion (n_frames, p) in the state model's components, and its path through the states."""

    motion: Array
    path: Path


def model_line(model: StateModel, cepstra: Array, events: Sequence[PhonemeEvent]) -> ModelledLine:
    """Return the motion of a line by Edge, Hilton and Jackson's method (this module's docstring).

    The cheapest path through the model's states is searched for the line's sound and phones; the
    motion is the likeliest trajectory along that path.

    Parameters
    ----------
    model : StateModel
        States, and stored units (pieces of the recordings).
    cepstra : Array
        (n_frames, n_cepstra) at the model's frame rate, normalised like the model's.
    events : Sequence[PhonemeEvent]
        Phones of the line.

    Returns
    -------
    ModelledLine
        Motion (n_frames, n_components of the face model), and its path through the states.
    """
    duration_s = len(cepstra) / model.frame_rate_hz
    spans = unit_spans(joined_phones(events, duration_s), len(cepstra), model.frame_rate_hz)
    search = _UnitSearch(model, cepstra, spans)
    path = cheapest_path(len(cepstra), search.candidates, model.follows, search.widen)
    precisions = np.asarray(np.linalg.inv(model.covariances[path.states]), dtype=np.float64)
    return ModelledLine(likeliest_trajectory(model.means[path.states], precisions), path)


@dataclass(slots=True)
class _RankedUnits:
    """The stored units for one phone of the line, most similar first, and those already in use.

    A stored unit is a piece of a recording around one phone. order: numbers of all units of the
    phone. states, distances: of each unit in use, (n_j,) its frames' states and (n, n_j) the
    distances of the n frames of the line's unit from them.
    """

    order: Indices
    states: list[Indices] = field(default_factory=list)
    distances: list[Array] = field(default_factory=list)


class _UnitSearch:
    """The stored units in use for each phone of a line, and the states that they allow each frame.

    Stored units are pieces of the recordings around one phone.
    """

    def __init__(self, model: StateModel, cepstra: Array, spans: Spans) -> None:
        """Rank the stored units for each phone of a line, and use the most similar one of each.

        model: the stored units and states. cepstra: (n, m), the line's sound. spans: the line's
        units.
        """
        self._model = model
        self._spans = spans
        self._window: Window = gaussian_window(WINDOW_DEVIATION_S, model.frame_rate_hz)
        n = len(cepstra)
        self._windows = self._window.of(cepstra, np.arange(n), (0, n))
        self._left, self._right = spans.neighbours(n, model.frame_rate_hz)
        known = frozenset(PHONEMES[i] for i in np.unique(model.units.phonemes))
        self._ranked = [
            _RankedUnits(self._rank_units(cepstra[first:end], stand_in(phoneme, known)))
            for phoneme, first, end in zip(spans.phonemes, spans.first, spans.end, strict=True)
        ]
        for number in range(len(self._ranked)):
            self._use_next_unit(number)

    def candidates(self, frame: int) -> Candidates:
        """Return the states open to a frame now, and its distances from them, by equation (2)."""
        states: list[Indices] = []
        distances: list[Array] = []
        # Of the stored units in use for the phones to the frame's left and right.
        for number in {int(self._left[frame]), int(self._right[frame])}:
            ranked = self._ranked[number]
            states += ranked.states
            distances += [each[frame - self._spans.first[number]] for each in ranked.distances]
        return nearest_of_each_state(states, distances)

    def widen(self, frame: int) -> int | None:
        """Add the next stored unit for the phones to the left and the right of frame `frame`.

        Return the first frame whose candidates change; None if no unit is left for either.
        """
        extended = [
            number
            for number in sorted({int(self._left[frame]), int(self._right[frame])})
            if self._use_next_unit(number)
        ]
        return min(int(self._spans.first[number]) for number in extended) if extended else None

    def _rank_units(self, target: Array, phonemes: tuple[str, ...]) -> Indices:
        """Return the numbers of the stored units of `phonemes`, most similar in sound first.

        target: (n, m), cepstra of the line's unit with which they are compared.
        """
        units = self._model.units
        numbers = np.concatenate([units.of(PHONEMES.index(p)) for p in phonemes])
        stored = [
            self._model.cepstra[units.first[i] : units.end[i]].astype(np.float64) for i in numbers
        ]
        return np.asarray(numbers[np.argsort(warped_distances(target, stored), kind="stable")])

    def _use_next_unit(self, number: int) -> bool:
        """Start using the next stored unit for phone `number`; return False if none is left.

        The unit's states and the distances of the line's frames from its frames become candidates.
        """
        ranked = self._ranked[number]
        n_used = len(ranked.states)
        if n_used == len(ranked.order):
            return False
        unit = int(ranked.order[n_used])
        first, end = int(self._model.units.first[unit]), int(self._model.units.end[unit])
        borders = self._model.sentence_of(first)
        stored = self._window.of(self._model.cepstra, np.arange(first, end), borders)
        span = slice(self._spans.first[number], self._spans.end[number])
        ranked.states.append(self._model.states[first:end])
        ranked.distances.append(unit_distances(self._windows[span], stored))
        return True
