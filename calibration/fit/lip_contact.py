"""Where closing stops: the gap between the dots of lips that touch, and what touching does.

Until they meet, lips go where the joints take them: the free face. Where the free face would bring
two dots nearer than they ever come, the lips stand in each other's way. The least gap is found
from the captured poses by turns with the free face, which is learnt without what the lips hide:
poses that count as in contact tell nothing of how high their lips would be. Dots beside the lips'
edges, thick lips and a neutral that is open are thereby all the same.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array

#: A pose this much beyond contact, and so many of them, are evidence; fewer say nothing.
_SURE_MM, _LEAST_POSES = 0.4, 3
#: Touching must explain the gaps of those poses this much better than going on does.
_BETTER = 0.6
_MOST_SOFT = 0.5
#: What touching does is nearly the same everywhere; a millimetre squared of doubt.
_RIDGE_MM2 = 2.0


@dataclass(frozen=True, slots=True)
class LipContact:
    """Where lips stop each other, and what that does.

    closed_mm: (n_gaps,), the dots' gaps where lips touch; pushed: (n_gaps, n_markers, 3), how
    markers yield to a millimetre of overlap in each gap; sure_mm: the standard error of closed_mm.
    """

    closed_mm: Array
    pushed: Array
    sure_mm: float

    def overlap_mm(self, free_gaps_mm: Array) -> Array:
        """(n, n_gaps) heights -> how far lips would overlap, >= 0."""
        return np.maximum(self.closed_mm - free_gaps_mm, 0.0)

    def seen_mm(self, free_mm: Array, free_gaps_mm: Array) -> Array:
        """(n, n_markers, 3) of the free face -> where the markers really are."""
        pushed = np.tensordot(self.overlap_mm(free_gaps_mm), self.pushed, axes=1)
        return np.asarray(free_mm + pushed)


def gap_heights_mm(markers_mm: Array, gaps: tuple[tuple[int, int], ...]) -> Array:
    """(n, n_markers, 3) -> (n, n_gaps): upper above lower."""
    upper, lower = ([pair[i] for pair in gaps] for i in (0, 1))
    return np.asarray(markers_mm[:, upper, 1] - markers_mm[:, lower, 1])


def poses_in_contact(free_gaps_mm: Array, closed_mm: Array) -> NDArray[np.bool_]:
    """(n,): poses whose middle gap would be narrower than the closed one."""
    return np.asarray(free_gaps_mm[:, 0] < closed_mm[0])


def first_closed_mm(seen_gaps_mm: Array, contact: NDArray[np.bool_]) -> Array:
    """(n_gaps,): the usual gap of poses in contact; as near as ever seen where those hide a dot."""
    is_seen = np.isfinite(seen_gaps_mm[contact]).any(axis=0)
    closing_mm = np.where(is_seen, seen_gaps_mm[contact], np.nanmin(seen_gaps_mm, axis=0))
    return np.asarray(np.nanmedian(closing_mm, axis=0))


def closed_gaps_mm(
    seen_gaps_mm: Array, free_gaps_mm: Array, contact: NDArray[np.bool_], closed_mm: Array
) -> Array:
    """(n_gaps,): where the gaps of poses in contact begin to stand still.

    Soft lips still give way: a line through the gaps by overlap, whose beginning is the closed
    gap, and which falls by nothing at least and half a millimetre a millimetre at most.
    """
    overlap = np.maximum(closed_mm[0] - free_gaps_mm[contact, 0], 0.0)
    begins = np.empty(seen_gaps_mm.shape[1])
    for gap, seen in enumerate(seen_gaps_mm[contact].T):
        known = np.isfinite(seen)
        if not known.any():
            # Dots that closed lips hide: as closed as they were believed to be.
            begins[gap] = closed_mm[gap]
            continue
        o, g = overlap[known], seen[known]
        falls = -np.sum((o - o.mean()) * (g - g.mean())) / (np.sum((o - o.mean()) ** 2) + 1.0)
        begins[gap] = np.median(g + np.clip(falls, 0.0, _MOST_SOFT) * o)
    return begins


def is_stopped(seen_gaps_mm: Array, free_gaps_mm: Array, closed_mm: Array) -> bool:
    """Whether the lips stop, rather than just go on: which explains their gaps better."""
    beyond = free_gaps_mm[:, 0] < closed_mm[0] - _SURE_MM
    seen, free = seen_gaps_mm[beyond, 0], free_gaps_mm[beyond, 0]
    known = np.isfinite(seen)
    if known.sum() < _LEAST_POSES:
        return False
    stays = np.sum((seen - closed_mm[0])[known] ** 2)
    goes_on = np.sum((seen - free)[known] ** 2)
    return bool(stays < _BETTER * goes_on)


def fit_contact(
    missed_mm: Array,
    seen_gaps_mm: Array,
    free_gaps_mm: Array,
    closed_mm: Array,
    gaps: tuple[tuple[int, int], ...],
) -> LipContact:
    """missed_mm: (n, n_markers, 3), captured less free, NaN where lost."""
    overlap = np.maximum(closed_mm - free_gaps_mm, 0.0)
    touched = overlap[:, 0] > 0.0
    o, r = overlap[touched], np.nan_to_num(missed_mm[touched])
    mean = o.mean(axis=1, keepdims=True)
    # First by the mean of the gaps, then what each gap adds of its own, which is little.
    by_mean = (mean.T @ r.reshape(len(r), -1)) / (mean.T @ mean + _RIDGE_MM2)
    pushed = np.repeat(by_mean, o.shape[1], axis=0) / o.shape[1]
    shaped = pushed.reshape(o.shape[1], *missed_mm.shape[1:]).copy()
    for gap, (upper, lower) in enumerate(gaps):
        # Between them the two dots give way by all of their own overlap, and by no other.
        for other in range(len(gaps)):
            total = 1.0 if other == gap else 0.0
            short = total - (shaped[other, upper, 1] - shaped[other, lower, 1])
            shaped[other, upper, 1] += short / 2
            shaped[other, lower, 1] -= short / 2
    spread = seen_gaps_mm[touched, 0]
    n = max(1, int(np.isfinite(spread).sum()))
    sure_mm = float(np.nanstd(spread)) / np.sqrt(n)
    return LipContact(closed_mm, shaped, sure_mm)
