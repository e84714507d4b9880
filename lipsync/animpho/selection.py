"""Selection of the AnimPho for the next phoneme: the paper's two strategies, and a guided one.

The paper's strategies use no later phonemes. They keep no state: what they need to remember is in
the `Choice` that they returned last, so that a choice can be undone. They select a connected and
smooth motion, and know of the mouth only through the phonemes.

`GuidedSelection` puts nearness to a target motion first, which is given at five times of the rest
of the phone. An AnimPho shows how the mouth moves and the target where it is: both are compared
about their own means.
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
    """The AnimPho (unit of captured mouth motion) selected for a phoneme p_t, after a_{t-1}.

    animpho: its index. missed: whether it is outside L(p_t), the phoneme's AnimPhos, or outside
    T(a_{t-1}), the successors; False for a first phoneme. chain_lengths: (m,), the priorities v_i
    of Wei and Deng, eq. (2), of all m AnimPhos, 0 outside L(p_t); empty for strategies without
    priorities.
    """

    animpho: int
    missed: bool
    chain_lengths: Array


class SelectionStrategy(Protocol):
    """A strategy that selects one AnimPho for each phoneme, which must have AnimPhos."""

    @property
    def name(self) -> str:
        """The name of the strategy on the command line."""

    def first(self, units: AnimPhoUnits, phoneme: str) -> Choice:
        """Return the AnimPho chosen for `phoneme`, the first of a chain from the closed mouth."""

    def following(self, units: AnimPhoUnits, phoneme: str, previous: Choice) -> Choice:
        """Return the AnimPho chosen for `phoneme`, the next of the chain after `previous`."""


def smoothness_energy(units: AnimPhoUnits, previous: int, candidates: Indices) -> Array:
    """Return the mouth's jump to each candidate, ||E(a_{t-1}) - B(eta)||. Wei and Deng, eq. (1).

    Parameters
    ----------
    units : AnimPhoUnits
        All AnimPhos.
    previous : int
        Index of the AnimPho played before.
    candidates : Indices
        (k,) indices of AnimPhos.

    Returns
    -------
    Array
        (k,) distances between the end of `previous` and the start of each candidate.
    """
    end = units.samples[previous, -1]
    return np.asarray(np.linalg.norm(units.samples[candidates, 0] - end, axis=1))


def nearest_to_rest(units: AnimPhoUnits, candidates: Indices) -> int:
    """Return the index of the candidate that starts nearest the closed mouth, to begin a chain.

    The paper has no rule for it.
    """
    distance = np.linalg.norm(units.samples[candidates, 0] - units.rest, axis=1)
    return int(candidates[np.argmin(distance)])


def chain_lengths(units: AnimPhoUnits, candidates: Indices, previous: Array) -> Array:
    """Return each AnimPho's chain length v_i: 0 outside `candidates`, else Wei and Deng, eq. (2).

    A candidate's v_i is the largest v_j of its predecessors plus 1; 1 where it has no predecessor.

    Parameters
    ----------
    units : AnimPhoUnits
        m AnimPhos.
    candidates : Indices
        (k,) indices of the AnimPhos of the phoneme.
    previous : Array
        (m,), the v_j of the phoneme before, 0 outside L(p_{t-1}).

    Returns
    -------
    Array
        (m,) chain lengths v_i.
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
    """Strategy: the smoothest of the phoneme's AnimPhos that follow the last AnimPho in training.

    The smoothest has the smallest jump from the last AnimPho's end, eq. (1). Where none of the
    phoneme's AnimPhos follows, it is the smoothest of all AnimPhos.
    """

    name = "naive"

    def first(self, units: AnimPhoUnits, phoneme: str) -> Choice:
        """Return the choice of the AnimPho of `phoneme` that starts nearest the closed mouth."""
        return Choice(nearest_to_rest(units, units.of_phoneme(phoneme)), False, np.empty(0))

    def following(self, units: AnimPhoUnits, phoneme: str, previous: Choice) -> Choice:
        """Return the choice of the successor of `previous` for `phoneme` with the smallest jump.

        If no AnimPho of the phoneme is a successor of `previous`, it is that of all AnimPhos with
        the smallest jump, eq. (1), and `missed` is set.
        """
        connected = np.intersect1d(
            units.of_phoneme(phoneme), units.successors[previous.animpho], assume_unique=True
        )
        missed = len(connected) == 0
        candidates = np.arange(len(units)) if missed else connected
        energy = smoothness_energy(units, previous.animpho, candidates)
        return Choice(int(candidates[np.argmin(energy)]), missed, np.empty(0))


class PrioritySelection:
    """Strategy: the AnimPho that ends the longest recorded chain which spells the phonemes so far.

    Among equals one that follows the last AnimPho in training, then the one with the smallest jump
    from the last AnimPho's end.
    """

    name = "priority"

    def first(self, units: AnimPhoUnits, phoneme: str) -> Choice:
        """Return the choice of the AnimPho of `phoneme` that starts nearest the closed mouth.

        The priorities are 1 for each AnimPho of the phoneme, else 0.
        """
        candidates = units.of_phoneme(phoneme)
        lengths = np.zeros(len(units))
        lengths[candidates] = 1.0
        return Choice(nearest_to_rest(units, candidates), False, lengths)

    def following(self, units: AnimPhoUnits, phoneme: str, previous: Choice) -> Choice:
        """Return the choice of the AnimPho of `phoneme` with the highest chain length v_i, eq. (2).

        Among equals a successor of a_{t-1}, the AnimPho of `previous`; then the smoothest by eq.
        (1).
        """
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
    """Weights of the costs that are added to a candidate's mean squared distance from the target.

    position: of the squared distance between the candidate's start and the mouth's present
    position; speed_s2: of the squared difference between their speeds, in s^2; unconnected: cost of
    a candidate outside T(a_{t-1}), the successors of the last AnimPho, in squared units of the
    components. Chosen on inner splits (decisions/0028).
    """

    position: float = 0.02
    speed_s2: float = 1e-5
    unconnected: float = 0.5


@dataclass(frozen=True, slots=True)
class Joint:
    """The mouth's state at the time within a phone at which a new stretch of motion begins.

    share: fraction of the phone that is over, from 0 to below 1; position, speed: (n_components,)
    each, of the mouth now, speed per second; spacing_s: seconds between two of the five samples of
    the rest of the phone; previous: index of the AnimPho a_{t-1}, None after rest.
    """

    share: float
    position: Array
    speed: Array
    spacing_s: float
    previous: int | None


@dataclass(frozen=True, slots=True)
class _Candidates:
    """The AnimPhos L(p) of a phoneme: indices (k,), samples (k, 5 n_components) minus their means.

    The means are removed because an AnimPho's position costs nothing. products: (k, 25), of the
    samples with each other over the components.
    """

    indices: Indices
    samples: Array
    products: Array


class GuidedSelection:
    """Selection of the AnimPho of a phoneme that fits a target motion at the least cost.

    All costs are squares of terms linear in the samples x (5, n_components) of an AnimPho, so their
    sum is x' M x + v x, with one M (5, 5) and one v for all candidates: two matrix products.
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
        """Return the index of the AnimPho of `phoneme` that costs least for the rest of a phone.

        Parameters
        ----------
        phoneme : str
            One of the model's known phonemes.
        target : Array
            (5, n_components), the wanted face at even times from now until the phone's end.
        joint : Joint
            State of the mouth that the AnimPho continues.

        Returns
        -------
        int
            Index of the AnimPho.
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
