"""Selection of the AnimPho (recorded piece of mouth motion) of a phoneme: three strategies.

The two strategies of Wei and Deng's paper use no later phonemes. They keep no state: what they need
to remember is in the `Choice` that they returned last, so that a choice can be undone. They select
a connected and smooth motion, and know of the mouth only through the phonemes.

`GuidedSelection` adds nearness to a target motion, which is given at five times of the rest of the
phone, to the paper's terms: the join, the recorded chain, the table T.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lipsync.animpho.trajectory import remainder_weights
from lipsync.animpho.units import SAMPLES_PER_ANIMPHO, AnimPhoUnits
from lipsync.arrays import Array

Indices = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Choice:
    """The AnimPho (recorded piece of mouth motion) selected for a phoneme p_t, after a_{t-1}.

    animpho: its index. missed: whether the AnimPho is outside L(p_t), the phoneme's AnimPhos, or
    outside T(a_{t-1}), the AnimPhos that followed the last one in the recordings; False for a first
    phoneme. chain_lengths: (m,), the priorities v_i of Wei and Deng, eq. (2), of all m AnimPhos, 0
    outside L(p_t); empty for strategies without priorities.
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
        All AnimPhos, recorded pieces of motion.
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
    """Return the chain lengths v_i: 0 outside `candidates`, else Wei and Deng, eq. (2).

    v_i tells how many phonemes in a row the recording that ends with AnimPho i spells: the largest
    v_j of its predecessors plus 1; 1 where it has no predecessor.

    Parameters
    ----------
    units : AnimPhoUnits
        m AnimPhos, recorded pieces of motion of one phoneme each.
    candidates : Indices
        (k,) indices of the AnimPhos of the phoneme.
    previous : Array
        (m,), the v_j of the phoneme before, 0 outside L(p_{t-1}); empty where there was none.

    Returns
    -------
    Array
        (m,) chain lengths v_i.
    """
    lengths = np.zeros(len(units))
    lengths[candidates] = 1.0
    if len(previous):
        # The longest chain among each AnimPho's predecessors, 0 where it has none.
        predecessors = units.predecessors
        # reduceat needs a non-empty stretch for every row: the 0 serves AnimPhos without any.
        previous_lengths = np.append(previous[predecessors.indices], 0.0)
        longest = np.maximum.reduceat(previous_lengths, predecessors.starts[:-1])
        longest[predecessors.starts[:-1] == predecessors.starts[1:]] = 0.0
        lengths[candidates] += longest[candidates]
    return lengths


class NaiveSelection:
    """Strategy: the smoothest of the phoneme's AnimPhos that followed the last AnimPho in training.

    AnimPhos are recorded pieces of motion. The smoothest has the smallest jump from the last
    AnimPho's end, eq. (1). Where none of the phoneme's AnimPhos follows, it is the smoothest of all
    AnimPhos.
    """

    name = "naive"

    def first(self, units: AnimPhoUnits, phoneme: str) -> Choice:
        """Choose the recorded piece (AnimPho) of `phoneme` that starts nearest the closed mouth."""
        return Choice(nearest_to_rest(units, units.of_phoneme(phoneme)), False, np.empty(0))

    def following(self, units: AnimPhoUnits, phoneme: str, previous: Choice) -> Choice:
        """Choose the recorded piece (AnimPho) of `phoneme` that jumps least after `previous`.

        Only pieces are considered that followed it in training. If there are none, the piece with
        the smallest jump of all, eq. (1), is chosen, and `missed` is set.
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

    AnimPhos are recorded pieces of motion. Among equals it is one that follows the last AnimPho in
    the recordings, then the one with the smallest jump from the last AnimPho's end.
    """

    name = "priority"

    def first(self, units: AnimPhoUnits, phoneme: str) -> Choice:
        """Choose the recorded piece (AnimPho) of `phoneme` that starts nearest the closed mouth.

        The chain lengths are 1 for each AnimPho of the phoneme, else 0.
        """
        candidates = units.of_phoneme(phoneme)
        lengths = chain_lengths(units, candidates, np.zeros(0))
        return Choice(nearest_to_rest(units, candidates), False, lengths)

    def following(self, units: AnimPhoUnits, phoneme: str, previous: Choice) -> Choice:
        """Choose the recorded piece (AnimPho) of `phoneme` that ends the longest chain, eq. (2).

        Among equals it is a successor of a_{t-1}, the AnimPho of `previous`; then the smoothest by
        eq. (1).
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


#: An AnimPho plays moved by this share of the way to where the mouth is expected (docs/motion.md).
MOVED_SHARE = 0.7


@dataclass(frozen=True, slots=True)
class SelectionCosts:
    """Weights of the costs that are added to a candidate's mean squared distance from the target.

    position: of the squared distance between the candidate's start, where it plays, and the mouth's
    present position, eq. (1); speed_s2: of the squared difference between their speeds, in s^2;
    unconnected: cost of a candidate outside T(a_{t-1}), the successors of the last AnimPho; chain:
    what doubling the chain length v_i, eq. (2), is worth; both in squared units of the components.
    Chosen on inner splits (docs/motion.md).
    """

    position: float = 0.02
    speed_s2: float = 1e-5
    unconnected: float = 2.0
    chain: float = 4.0


@dataclass(frozen=True, slots=True)
class Joint:
    """The mouth's state where a new stretch of motion joins the old one; no joint of a robot.

    share: fraction of the phone that is over, from 0 to below 1; position, speed: (n_components,)
    each, of the mouth now, speed per second; spacing_s: seconds between two of the five samples of
    the rest of the phone; previous: the choice of a_{t-1}, None after rest.
    """

    share: float
    position: Array
    speed: Array
    spacing_s: float
    previous: Choice | None


@dataclass(frozen=True, slots=True)
class _Candidates:
    """The AnimPhos (recorded pieces of motion) of a phoneme.

    indices (k,); samples (k, 5 n_components); products: (k, 25), of the samples with each other
    over the components.
    """

    indices: Indices
    samples: Array
    products: Array


class GuidedSelection:
    """Selection of the AnimPho of a phoneme that fits a target motion at the least cost.

    An AnimPho is a recorded piece of motion. Nearness, join and speed are squares of terms linear
    in its samples x (5, n_components), so their sum is x' M x - 2 v x + a constant, with one M (5,
    5) and one v (5, n_components) for all candidates: two matrix products.
    """

    def __init__(self, units: AnimPhoUnits, costs: SelectionCosts | None = None) -> None:
        self.units = units
        self._costs = costs or SelectionCosts()
        nearness_weights = [1.0 / SAMPLES_PER_ANIMPHO] * SAMPLES_PER_ANIMPHO
        self._weights = np.array([*nearness_weights, self._costs.position, self._costs.speed_s2])
        self._candidates = {p: _candidates(units, p) for p in units.known_phonemes}

    def choose(self, phoneme: str, target: Array, joint: Joint) -> Choice:
        """Return the recorded piece (AnimPho) that costs least for the rest of a phone.

        Parameters
        ----------
        phoneme : str
            One of the model's known phonemes.
        target : Array
            (5, n_components), the expected faces at even times from now until the phone's end.
        joint : Joint
            The mouth's state now, which the AnimPho continues.

        Returns
        -------
        Choice
            The AnimPho, and the chain lengths that the next choice needs.
        """
        candidates = self._candidates[phoneme]
        remainder = remainder_weights(joint.share)
        first_sample = remainder[0] - MOVED_SHARE * remainder.mean(axis=0)
        first_speed = (remainder[1] - remainder[0]) / joint.spacing_s
        # Seven terms, linear in an AnimPho's five samples, and what each should be: the samples
        # themselves (nearness), and position and speed at the start (eq. (1)). The AnimPho plays
        # moved by a share of its distance from the target, which changes the position.
        terms = np.vstack([remainder, first_sample, first_speed])
        position = joint.position - MOVED_SHARE * target.mean(axis=0)
        targets = np.vstack([target, position, joint.speed])
        weighted = terms.T * self._weights
        # The weighted sum of squared differences, without the part that is equal for all.
        squares, products = weighted @ terms, weighted @ targets
        cost = candidates.products @ squares.ravel() - candidates.samples @ (2.0 * products.ravel())
        # The paper's terms: a successor of the last AnimPho, and a long recorded chain.
        previous_lengths = np.zeros(0) if joint.previous is None else joint.previous.chain_lengths
        lengths = chain_lengths(self.units, candidates.indices, previous_lengths)
        successors = candidates.indices
        if joint.previous is not None:
            successors = self.units.successors[joint.previous.animpho]
        missed = ~np.isin(candidates.indices, successors)
        cost += self._costs.unconnected * missed
        cost -= self._costs.chain * np.log2(lengths[candidates.indices])
        best = int(np.argmin(cost))
        return Choice(int(candidates.indices[best]), bool(missed[best]), lengths)


def _candidates(units: AnimPhoUnits, phoneme: str) -> _Candidates:
    indices = units.of_phoneme(phoneme)
    samples = units.samples[indices]
    products = np.einsum("ksn,ktn->kst", samples, samples)
    k = len(indices)
    return _Candidates(indices, samples.reshape(k, -1), products.reshape(k, -1))
