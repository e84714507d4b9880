"""How unlike each state is to a frame of the new line, by what was heard around its frames.

Edge, Hilton and Jackson, step 3 of synthesis. The distance of two windows of sound is the Euclidean
one of their cepstra, each frame weighted by a Gaussian around the middle.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from lipsync.arrays import Array, Indices


@dataclass(frozen=True, slots=True)
class Window:
    """offsets (w,) in frames around the middle, weights (w,), which add up to 1."""

    offsets: Indices
    weights: Array

    def of(self, cepstra: NDArray[np.floating], frames: Indices, borders: tuple[int, int]) -> Array:
        """What is heard around `frames` (n,): (n, w m), weighted so that distances are (2)'s.

        cepstra: (n_frames, m); borders: first frame of the recording, and the one after its last;
        beyond them its ends are repeated.
        """
        first, end = borders
        numbers = np.clip(frames[:, None] + self.offsets, first, end - 1)
        weighted = cepstra[numbers] * np.sqrt(self.weights)[:, None]
        return np.asarray(weighted.reshape(len(frames), -1))


def gaussian_window(deviation_s: float, frame_rate_hz: float) -> Window:
    """A window of three standard deviations to both sides."""
    deviation = deviation_s * frame_rate_hz
    reach = int(np.ceil(3.0 * deviation))
    offsets = np.arange(-reach, reach + 1)
    weights = np.exp(-0.5 * (offsets / max(deviation, 1e-9)) ** 2)
    return Window(offsets, weights / weights.sum())


@dataclass(frozen=True, slots=True)
class Candidates:
    """The states that a frame may be in, (n,), each once, and how far it is from each, (n,)."""

    states: Indices
    distances: Array


def unit_distances(heard: Array, stored: Array) -> Array:
    """The distance of each window around frames of a line to each of those around a unit's frames.

    heard (n, w m), stored (n_j, w m), as `Window.of` gives them: (n, n_j), with

    dist(t, f) = sqrt( sum_w g(w) || c(t + w) - c'(f + w) ||^2 ).
    """
    return np.asarray(cdist(heard, stored), dtype=np.float64)


def nearest_of_each_state(states: Sequence[Indices], distances: Sequence[Array]) -> Candidates:
    """dist(t, k) = min over frames f of the units that lie in state k, equation (2).

    states, distances: (n_j,) for each unit. States that are in none of them are infinitely far, and
    left out.
    """
    all_states, all_distances = np.concatenate(states), np.concatenate(distances)
    order = np.lexsort((all_distances, all_states))
    found, first = np.unique(all_states[order], return_index=True)
    return Candidates(found, all_distances[order][first])
