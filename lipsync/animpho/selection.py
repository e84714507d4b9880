"""Which AnimPho plays the next phoneme: the paper's two strategies.

Neither looks ahead. What a strategy remembers is in the `Choice` it returned last, so that it can
be taken back without a trace.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lipsync.face.model import FaceModel

Array = NDArray[np.float64]
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
    """Picks AnimPhos phoneme by phoneme. Phonemes must be known to the model."""

    @property
    def name(self) -> str:
        """As it is called on the command line."""

    def first(self, model: FaceModel, phoneme: str) -> Choice:
        """The start of a chain, out of the closed mouth."""

    def following(self, model: FaceModel, phoneme: str, previous: Choice) -> Choice:
        """The next link after `previous`."""


def smoothness_energy(model: FaceModel, previous: int, candidates: Indices) -> Array:
    """||E(a_{t-1}) - B(eta)|| for each candidate (k,); lower is smoother. Wei and Deng, eq. (1)."""
    end = model.animphos[previous, -1]
    return np.asarray(np.linalg.norm(model.animphos[candidates, 0] - end, axis=1))


def nearest_to_rest(model: FaceModel, candidates: Indices) -> int:
    """The AnimPho that starts nearest the closed mouth; the paper is silent on the first one."""
    distance = np.linalg.norm(model.animphos[candidates, 0] - model.rest, axis=1)
    return int(candidates[np.argmin(distance)])


def chain_lengths(model: FaceModel, candidates: Indices, previous: Array) -> Array:
    """v_i for each AnimPho (m,): 0 outside `candidates`, else eq. (2).

    previous: (m,), the v_j of the phoneme before, 0 outside L(p_{t-1}); so the longest chain
    through a predecessor is its v_j + 1, and 0 + 1 = 1 where there is none.
    """
    before = model.predecessors
    # reduceat needs a non-empty stretch for every row: the appended 0 serves AnimPhos without any.
    reached = np.append(previous[before.indices], 0.0)
    longest = np.maximum.reduceat(reached, before.starts[:-1])
    longest[before.starts[:-1] == before.starts[1:]] = 0.0
    lengths = np.zeros(len(model.animphos))
    lengths[candidates] = longest[candidates] + 1.0
    return lengths


class NaiveSelection:
    """The smoothest of L(p_t) and T(a_{t-1}); of all AnimPhos when none is in both."""

    name = "naive"

    def first(self, model: FaceModel, phoneme: str) -> Choice:
        """The AnimPho of the phoneme that starts nearest the closed mouth."""
        return Choice(nearest_to_rest(model, model.of_phoneme(phoneme)), False, np.empty(0))

    def following(self, model: FaceModel, phoneme: str, previous: Choice) -> Choice:
        """Eq. (1) over phi."""
        connected = np.intersect1d(
            model.of_phoneme(phoneme), model.successors[previous.animpho], assume_unique=True
        )
        missed = len(connected) == 0
        candidates = np.arange(len(model.animphos)) if missed else connected
        energy = smoothness_energy(model, previous.animpho, candidates)
        return Choice(int(candidates[np.argmin(energy)]), missed, np.empty(0))


class PrioritySelection:
    """The end of the longest chain that spells the phonemes so far; then connected; then smooth."""

    name = "priority"

    def first(self, model: FaceModel, phoneme: str) -> Choice:
        """All priorities are 1; the AnimPho that starts nearest the closed mouth."""
        candidates = model.of_phoneme(phoneme)
        lengths = np.zeros(len(model.animphos))
        lengths[candidates] = 1.0
        return Choice(nearest_to_rest(model, candidates), False, lengths)

    def following(self, model: FaceModel, phoneme: str, previous: Choice) -> Choice:
        """Highest v_i of eq. (2); among equals one connected with a_{t-1}; then eq. (1)."""
        candidates = model.of_phoneme(phoneme)
        lengths = chain_lengths(model, candidates, previous.chain_lengths)
        best = candidates[lengths[candidates] == lengths[candidates].max()]
        connected = np.intersect1d(best, model.successors[previous.animpho], assume_unique=True)
        if len(connected):
            best = connected
        energy = smoothness_energy(model, previous.animpho, best)
        return Choice(int(best[np.argmin(energy)]), len(connected) == 0, lengths)


STRATEGIES: dict[str, SelectionStrategy] = {
    strategy.name: strategy for strategy in (NaiveSelection(), PrioritySelection())
}
