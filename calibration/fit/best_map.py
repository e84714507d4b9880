"""The map that runs, chosen: which kind, and how far past contact it presses where lips close.

Loads scikit-learn; the live path never does.
"""

from dataclasses import dataclass, replace

import numpy as np
from sklearn.cluster import KMeans

from calibration.fit.lip_contact import gap_heights_mm
from calibration.fit.retargeting import Retargeting
from calibration.run.run_time_map import RunTimeMap, fit_run_time_map
from lipsync.arrays import Array

#: A map with bends around so many of the speaker's mouths, or a quadratic one.
_CENTRES = 40
_LEARN_SHARE = 0.8
#: A frame in which the speaker closes counts as so many others: a closure that is missed shows.
_CLOSURE_COUNTS = 6.0
#: So many of the closures must be past contact by so much; then the map's own misses are made up
#: for, by so much at most: more would shut small openings.
_CLOSED_SHARE, _PAST_MM, _MOST_MORE_MM = 0.98, 0.4, 1.2
_ROUNDS = 3


@dataclass(frozen=True, slots=True)
class ChosenMap:
    """The map, and what it was asked for, its pressing included."""

    run: RunTimeMap
    retargeting: Retargeting


def choose_map(retargeting: Retargeting, from_rest: Array) -> ChosenMap:
    """from_rest: (n, n_components), speech, AnimPhos by AnimPhos.

    Kinds are compared on the last fifth, in gap and shape, as far as the face is learnt.
    """
    most_mm = retargeting.press_mm + _MOST_MORE_MM
    poses_deg = retargeting.poses_deg(from_rest)
    n_learnt = round(_LEARN_SHARE * len(from_rest))
    kinds = [None, _centres(from_rest)]
    missed = []
    for centres in kinds:
        run = _fitted(retargeting, from_rest[:n_learnt], poses_deg[:n_learnt], centres)
        missed.append(_missed(retargeting, run, from_rest[n_learnt:], poses_deg[n_learnt:]))
    centres = kinds[int(np.argmin(missed))]
    run = _fitted(retargeting, from_rest, poses_deg, centres)
    for _ in range(_ROUNDS):
        closes = retargeting.closing(from_rest) >= 1.0
        short_mm = _short_mm(retargeting, run, from_rest[closes])
        if short_mm <= 0.0 or retargeting.press_mm >= most_mm:
            break
        press_mm = min(retargeting.press_mm + short_mm, most_mm)
        retargeting = replace(retargeting, press_mm=press_mm)
        run = _fitted(retargeting, from_rest, retargeting.poses_deg(from_rest), centres)
    return ChosenMap(run, retargeting)


def _centres(from_rest: Array) -> Array | None:
    if len(np.unique(from_rest, axis=0)) < 4 * _CENTRES:
        return None
    found = KMeans(_CENTRES, n_init=1, random_state=0).fit(from_rest)
    return np.asarray(found.cluster_centers_, dtype=np.float64)


def _fitted(
    retargeting: Retargeting, from_rest: Array, poses_deg: Array, centres: Array | None
) -> RunTimeMap:
    mouth = retargeting.mouth
    counts = 1.0 + (_CLOSURE_COUNTS - 1.0) * retargeting.closing(from_rest)
    return fit_run_time_map(
        from_rest, poses_deg, mouth.markers_of, mouth.names.shape_features, centres, counts
    )


def _missed(retargeting: Retargeting, run: RunTimeMap, from_rest: Array, poses_deg: Array) -> float:
    """Weighted square millimetres of shape and gap between the map's poses and the best."""
    mouth = retargeting.mouth
    of = mouth.names.shape_features
    shown = of.of(mouth.seen_mm(mouth.kept_deg(run.free_deg(from_rest))))
    return float(np.mean((shown - of.of(mouth.seen_mm(poses_deg))) ** 2))


def _short_mm(retargeting: Retargeting, run: RunTimeMap, from_rest: Array) -> float:
    """By how much most closures are less past contact than they must be."""
    if not len(from_rest):
        return 0.0
    mouth = retargeting.mouth
    free_mm = mouth.markers_of(mouth.kept_deg(run.free_deg(from_rest)))
    heights_mm = gap_heights_mm(free_mm, mouth.names.shape_features.gaps[:1])[:, 0]
    reached_mm = float(np.quantile(heights_mm, _CLOSED_SHARE))
    return reached_mm - (float(retargeting.closed_mm[0]) - _PAST_MM)
