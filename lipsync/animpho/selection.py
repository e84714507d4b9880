"""Which AnimPho plays the next phoneme: the paper's two strategies, and one guided by a target.

The paper's strategies do not look ahead. What a strategy remembers is in the `Choice` it returned
last, so that it can be taken back without a trace.

They ask for connected and for smooth, and hear of the mouth only through the phonemes.
`GuidedSelection` asks first for near: it is given a target at five times of what is left of the
phone. An AnimPho says how the mouth moves and the target where: both are compared about their own
means.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lipsync.animpho.trajectory import left_samples
from lipsync.animpho.units import SAMPLES_PER_ANIMPHO, AnimPhoUnits
from lipsync.arrays import Array

Indices = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Choice:
    """The AnimPho taken for a phoneme.

    chain_lengths: (m,), the priorities v_i of eq. (2), 0 outside L(p_t); empty for strategies
    without. missed: the AnimPho is not in L(p_t) and T(a_{t-1}) both. A first phoneme never misses.
    """

    animpho: int
    missed: bool
    chain_lengths: Array


class SelectionStrategy(Protocol):
    """Picks AnimPhos phoneme by phoneme. Phonemes must be known to them."""

    @property
    def name(self) -> str:
        """Its name on the command line."""

    def first(self, units: AnimPhoUnits, phoneme: str) -> Choice:
        """The start of a chain, out of the closed mouth."""

    def following(self, units: AnimPhoUnits, phoneme: str, previous: Choice) -> Choice:
        """The next link after `previous`."""


def smoothness_energy(units: AnimPhoUnits, previous: int, candidates: Indices) -> Array:
    """Return ||E(a_{t-1}) - B(eta)|| for each candidate; lower is smoother. Wei and Deng, eq. (1).

    Parameters
    ----------
    units : AnimPhoUnits
        All AnimPhos.
    previous : int
        Number of the AnimPho before.
    candidates : Indices
        (k,) numbers.

    Returns
    -------
    Array
        (k,).
    """
    end = units.samples[previous, -1]
    return np.asarray(np.linalg.norm(units.samples[candidates, 0] - end, axis=1))


def nearest_to_rest(units: AnimPhoUnits, candidates: Indices) -> int:
    """The AnimPho that starts nearest the closed mouth; the paper is silent on the first one."""
    distance = np.linalg.norm(units.samples[candidates, 0] - units.rest, axis=1)
    return int(candidates[np.argmin(distance)])


def chain_lengths(units: AnimPhoUnits, candidates: Indices, previous: Array) -> Array:
    """Return v_i for each AnimPho: 0 outside `candidates`, else Wei and Deng, eq. (2).

    The longest chain through a predecessor is its v_j + 1, and 0 + 1 = 1 where there is none.

    Parameters
    ----------
    units : AnimPhoUnits
        m AnimPhos.
    candidates : Indices
        (k,) numbers.
    previous : Array
        (m,), the v_j of the phoneme before, 0 outside L(p_{t-1}).

    Returns
    -------
    Array
        (m,).
    """
    before = units.predecessors
    # reduceat needs a non-empty stretch for every row: the appended 0 serves AnimPhos without any.
    reached = np.append(previous[before.indices], 0.0)
    longest = np.maximum.reduceat(reached, before.starts[:-1])
    longest[before.starts[:-1] == before.starts[1:]] = 0.0
    lengths = np.zeros(len(units))
    lengths[candidates] = longest[candidates] + 1.0
    return lengths


class NaiveSelection:
    """The smoothest of L(p_t) and T(a_{t-1}); of all AnimPhos when none is in both."""

    name = "naive"

    def first(self, units: AnimPhoUnits, phoneme: str) -> Choice:
        """The AnimPho of the phoneme that starts nearest the closed mouth."""
        return Choice(nearest_to_rest(units, units.of_phoneme(phoneme)), False, np.empty(0))

    def following(self, units: AnimPhoUnits, phoneme: str, previous: Choice) -> Choice:
        """Eq. (1) over phi."""
        connected = np.intersect1d(
            units.of_phoneme(phoneme), units.successors[previous.animpho], assume_unique=True
        )
        missed = len(connected) == 0
        candidates = np.arange(len(units)) if missed else connected
        energy = smoothness_energy(units, previous.animpho, candidates)
        return Choice(int(candidates[np.argmin(energy)]), missed, np.empty(0))


class PrioritySelection:
    """The end of the longest chain that spells the phonemes so far; then connected; then smooth."""

    name = "priority"

    def first(self, units: AnimPhoUnits, phoneme: str) -> Choice:
        """All priorities are 1; the AnimPho that starts nearest the closed mouth."""
        candidates = units.of_phoneme(phoneme)
        lengths = np.zeros(len(units))
        lengths[candidates] = 1.0
        return Choice(nearest_to_rest(units, candidates), False, lengths)

    def following(self, units: AnimPhoUnits, phoneme: str, previous: Choice) -> Choice:
        """Highest v_i of eq. (2); among equals one connected with a_{t-1}; then eq. (1)."""
        candidates = units.of_phoneme(phoneme)
        lengths = chain_lengths(units, candidates, previous.chain_lengths)
        best = candidates[lengths[candidates] == lengths[candidates].max()]
        connected = np.intersect1d(best, units.successors[previous.animpho], assume_unique=True)
        if len(connected):
            best = connected
        energy = smoothness_energy(units, previous.animpho, best)
        return Choice(int(best[np.argmin(energy)]), len(connected) == 0, lengths)


STRATEGIES: dict[str, SelectionStrategy] = {
    strategy.name: strategy for strategy in (NaiveSelection(), PrioritySelection())
}


@dataclass(frozen=True, slots=True)
class SelectionCosts:
    """What a candidate is charged beside its mean squared distance from the target.

    position: for the squared distance between its start and the mouth as it is; speed_s2: for the
    squared difference of their speeds, s^2; unconnected: for not being in T(a_{t-1}), in squared
    units of the components. Chosen on inner splits (decisions/0028).
    """

    position: float = 0.02
    speed_s2: float = 1e-5
    unconnected: float = 0.5


@dataclass(frozen=True, slots=True)
class Joint:
    """Where a new stretch takes over.

    share: how much of the phone is over, from 0 to below 1; position, speed: (n_components,) each,
    of the mouth as it is, speed per second; spacing_s: between two of the five samples of what is
    left; previous: a_{t-1}, None out of rest.
    """

    share: float
    position: Array
    speed: Array
    spacing_s: float
    previous: int | None


@dataclass(frozen=True, slots=True)
class _Candidates:
    """L(p): samples (k, 5 n_components) about their means, as where an AnimPho lies costs nothing.

    products: (k, 25), of the samples with each other over the components.
    """

    indices: Indices
    samples: Array
    products: Array


class GuidedSelection:
    """The AnimPho of a phoneme that costs least.

    All costs are squares of what is linear in the samples x (5, n_components) of an AnimPho, so
    their sum is x' M x + v x, with one M (5, 5) and one v for all candidates: two products.
    """

    def __init__(self, units: AnimPhoUnits, costs: SelectionCosts | None = None) -> None:
        self._units = units
        costs = costs or SelectionCosts()
        near = [1.0 / SAMPLES_PER_ANIMPHO] * SAMPLES_PER_ANIMPHO
        self._weights = np.array([*near, costs.position, costs.speed_s2])
        self._unconnected_cost = costs.unconnected
        self._unconnected = np.ones(len(units))
        self._candidates = {p: _candidates(units, p) for p in units.known_phonemes}

    def choose(self, phoneme: str, target: Array, joint: Joint) -> int:
        """Choose the AnimPho of a known phoneme for the rest of a phone.

        Parameters
        ----------
        phoneme : str
            Of the model's.
        target : Array
            (5, n_components), from now until the phone's end.
        joint : Joint
            What the AnimPho continues.

        Returns
        -------
        int
            Its number.
        """
        candidates = self._candidates[phoneme]
        centre = target.mean(axis=0)
        left = left_samples(joint.share)
        moved = left - left.mean(axis=0)
        step = (left[1] - left[0]) / joint.spacing_s
        # Nearness; eq. (1), of position and of speed: rows that should vanish, each by its weight.
        seen = np.vstack([moved, moved[:1], step])
        wanted = np.vstack([target - centre, joint.position - centre, joint.speed])
        weighted = seen.T * self._weights
        squares, products = weighted @ seen, weighted @ wanted
        cost = candidates.products @ squares.ravel() - candidates.samples @ (2.0 * products.ravel())
        if joint.previous is not None:
            followers = self._units.successors[joint.previous]
            self._unconnected[followers] = 0.0
            cost += self._unconnected_cost * self._unconnected[candidates.indices]
            self._unconnected[followers] = 1.0
        return int(candidates.indices[np.argmin(cost)])


def _candidates(units: AnimPhoUnits, phoneme: str) -> _Candidates:
    indices = units.of_phoneme(phoneme)
    samples = units.samples[indices]
    samples = samples - samples.mean(axis=1, keepdims=True)
    products = np.einsum("ksn,ktn->kst", samples, samples)
    k = len(indices)
    return _Candidates(indices, samples.reshape(k, -1), products.reshape(k, -1))
