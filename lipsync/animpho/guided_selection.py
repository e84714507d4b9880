"""Which AnimPho plays a phoneme when it is known where the mouth should go.

The paper's selections ask for connected and for smooth, and hear of the mouth only through the
phonemes. This one asks first for near: it is given a target at the phone's five sample times. An
AnimPho says how the mouth moves and the target where: both are compared about their own means.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lipsync.animpho.units import SAMPLES_PER_ANIMPHO, AnimPhoUnits
from lipsync.arrays import Array

Indices = NDArray[np.int64]


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
    of the mouth as it is, speed per second; phone_s: how long the whole phone lasts; previous:
    a_{t-1}, None out of rest.
    """

    share: float
    position: Array
    speed: Array
    phone_s: float
    previous: int | None

    @property
    def n_passed(self) -> int:
        """How many of the phone's samples lie before; the last one never does."""
        return min(SAMPLES_PER_ANIMPHO - 1, int(np.ceil(self.share * (SAMPLES_PER_ANIMPHO - 1))))


@dataclass(frozen=True, slots=True)
class _Candidates:
    """L(p) less a number of first samples.

    samples: (k, 5, n_components), all of them; mean: (k, n_components), of what is left; shape:
    (k, r n_components), what is left about its mean; square: (k,), of the shape's length.
    """

    indices: Indices
    samples: Array
    mean: Array
    shape: Array
    square: Array


class GuidedSelection:
    """The AnimPho of a phoneme that costs least."""

    def __init__(self, units: AnimPhoUnits, costs: SelectionCosts | None = None) -> None:
        self._units = units
        self._costs = costs or SelectionCosts()
        self._unconnected = np.ones(len(units))
        self._candidates = {
            (phoneme, n_passed): _candidates(units, phoneme, n_passed)
            for phoneme in units.known_phonemes
            for n_passed in range(SAMPLES_PER_ANIMPHO)
        }

    def choose(self, phoneme: str, target: Array, joint: Joint) -> int:
        """The AnimPho of a known phoneme for what is left of a phone; its number.

        target: (r, n_components) at the sample times that are still to come.
        """
        found = self._candidates[phoneme, joint.n_passed]
        centre = target.mean(axis=0)
        cost = found.square - 2.0 * (found.shape @ (target - centre).reshape(-1))
        cost /= len(target)
        cost += self._roughness(found, centre, joint)
        if joint.previous is not None:
            followers = self._units.successors[joint.previous]
            self._unconnected[followers] = 0.0
            cost += self._costs.unconnected * self._unconnected[found.indices]
            self._unconnected[followers] = 1.0
        return int(found.indices[np.argmin(cost)])

    def _roughness(self, found: _Candidates, centre: Array, joint: Joint) -> Array:
        """Eq. (1) for each candidate (k,), squared, of position and of speed."""
        at = joint.share * (SAMPLES_PER_ANIMPHO - 1)
        number = min(int(at), SAMPLES_PER_ANIMPHO - 2)
        here = found.samples[:, number]
        step = found.samples[:, number + 1] - here
        start = here + (at - number) * step - found.mean
        apart = start - (joint.position - centre)
        cost = self._costs.position * np.einsum("kn,kn->k", apart, apart)
        apart = step * ((SAMPLES_PER_ANIMPHO - 1) / joint.phone_s) - joint.speed
        cost += self._costs.speed_s2 * np.einsum("kn,kn->k", apart, apart)
        return np.asarray(cost)


def _candidates(units: AnimPhoUnits, phoneme: str, n_passed: int) -> _Candidates:
    indices = units.of_phoneme(phoneme)
    samples = units.samples[indices]
    left = samples[:, n_passed:]
    mean = left.mean(axis=1)
    shape = (left - mean[:, None]).reshape(len(left), -1)
    return _Candidates(indices, samples, mean, shape, (shape**2).sum(axis=1))
