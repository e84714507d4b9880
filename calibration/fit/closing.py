"""Whether and at which pose lips meet, by ladders: poses that close the lips in small steps.

A ladder begins with the lips open in one of the shapes in which the speaker closes them, and goes
on in small steps by all joints that close, as far as their limits. How far each step should close
the lips is predicted by a straight line from the learnt face at the open end; so a joint at its
limit is predicted to do nothing, and is not taken for contact. Contact is a ladder that goes on
closing while the dots of upper and lower lip, all of them, come no nearer: the far lip is pushed
along. One kink in all ladders must explain the apertures far better than none, and leave little of
the slope.
Loads scikit-learn; the live path never does.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sklearn.cluster import KMeans

from calibration.capture.capture import Capture, ladders_of
from calibration.fit.retargeting import Retargeting, bounded_minimum, gap_heights_mm
from lipsync.arrays import Array

#: Shapes in which lips are closed, millimetres of a step, and how far above the gap that is
#: believed to be the closed one ladders begin.
N_SHAPES, _STEP_MM, _BEGIN_MM = 3, 0.4, 2.4
#: Steps that come first, and that are added for as long as neither contact nor limits were seen.
FIRST_STEPS, MORE_STEPS, MOST_STEPS = 10, 4, 26
#: What a degree costs against a millimetre, so that joints that do little stay where they are.
_TURN_MM_PER_DEG = 0.03
_DIFFERENCE_DEG = 1.0
#: A step that closes less than this is none: joints stand at their limits.
_LEAST_STEP_MM = 0.12

#: Dots of both lips, one above the other.
_OPPOSITE = (
    ("inner_lip_13", "inner_lip_14"), ("inner_lip_82", "inner_lip_87"),
    ("inner_lip_312", "inner_lip_317"), ("outer_lip_0", "outer_lip_17"),
    ("outer_lip_37", "outer_lip_84"), ("outer_lip_267", "outer_lip_314"),
    ("outer_lip_39", "outer_lip_181"), ("outer_lip_269", "outer_lip_405"),
)  # fmt: skip
#: (n, n_servos) degrees -> (n, n_markers, 3) millimetres.
_MarkersOf = Callable[[Array], Array]


@dataclass(frozen=True, slots=True)
class Ladder:
    """Poses of one ladder, which closes the lips in small steps.

    goals_deg: (n_steps, n_servos); from_below: (n_servos,), 1 or -1, the side joints come from.
    """

    goals_deg: Array
    from_below: Array


def plan_ladders(retargeting: Retargeting, from_rest: Array, n_steps: int) -> list[Ladder]:
    """Return ladders of poses that close the lips step by step, one for each usual closed shape.

    Parameters
    ----------
    retargeting : Retargeting
        The learnt face.
    from_rest : Array
        (n, n_components) mm from rest, frames in which the speaker's lips are closed.
    n_steps : int
        Largest number of steps of each ladder.

    Returns
    -------
    list[Ladder]
        Ladders of goals in degrees.
    """
    n_shapes = min(N_SHAPES, len(np.unique(from_rest, axis=0)))
    shapes = KMeans(n_shapes, n_init=2, random_state=0).fit(from_rest).cluster_centers_
    open_gap_mm = float(retargeting.closed_mm[0]) + _BEGIN_MM
    return [
        _ladder(retargeting, retargeting.at_gap(shape[None], open_gap_mm)[0], n_steps)
        for shape in shapes
    ]


def _ladder(retargeting: Retargeting, base_deg: Array, n_steps: int) -> Ladder:
    """Return the ladder of up to `n_steps` steps from the open pose `base_deg`, (n_servos,).

    Each step closes all gaps of the learnt mouth's lips by an equal amount; the ladder ends before
    the first step that closes the middle gap by less than 0.12 mm, as joints are at their limits.
    """
    mouth = retargeting.mouth
    gap_slopes = pair_slopes(mouth.markers_of, base_deg, mouth.names.shape_features.gaps)
    # Least squares: every gap falls by 0.4 mm a step, and turning costs a little, within the
    # limits.
    cost = gap_slopes.T @ gap_slopes + _TURN_MM_PER_DEG**2 * np.eye(len(base_deg))
    gains = -_STEP_MM * np.arange(n_steps)[:, None] * gap_slopes.sum(axis=0)
    least_deg, most_deg = (limit - base_deg for limit in mouth.limits_deg)
    turned_deg = bounded_minimum(np.repeat(cost[None], n_steps, axis=0), gains, least_deg, most_deg)
    goals_deg = mouth.limited_deg(base_deg + turned_deg)
    # Steps that hardly close the middle gap, by its slopes.
    stuck = np.flatnonzero(np.diff(-goals_deg @ gap_slopes[0]) < _LEAST_STEP_MM)
    n_kept = int(stuck[0]) + 1 if len(stuck) else n_steps
    direction = np.sign(goals_deg[n_kept - 1] - base_deg)
    return Ladder(goals_deg[:n_kept], np.where(direction == 0.0, 1.0, direction))


def pair_slopes(markers_of: _MarkersOf, base_deg: Array, pairs: Sequence[tuple[int, int]]) -> Array:
    """Return the change of each marker pair's height per degree of each joint.

    Parameters
    ----------
    markers_of : _MarkersOf
        Function from poses (k, n_servos) degrees to markers (k, n_markers, 3) mm.
    base_deg : Array
        (n_servos,) degrees, the pose at which slopes are taken.
    pairs : Sequence[tuple[int, int]]
        Numbers of each upper and lower marker.

    Returns
    -------
    Array
        (n_pairs, n_servos) mm / degree.
    """
    steps = _DIFFERENCE_DEG * np.eye(len(base_deg))
    more = gap_heights_mm(markers_of(base_deg + steps), tuple(pairs))
    less = gap_heights_mm(markers_of(base_deg - steps), tuple(pairs))
    return np.asarray((more - less).T / (2 * _DIFFERENCE_DEG))


#: Slopes of the learnt face about the open end are right by such a share.
_SLOPE_SD = 0.25
#: A kink of all ladders together must explain so much, in square standard errors, and leave so
#: little of the slope, by two standard errors; noise alone explains 5 a ladder.
_SURE_EVIDENCE, _MOST_SLOPE_LEFT = 22.0, 0.7
#: A ladder of fewer steps tells nothing.
_FEWEST_STEPS = 5
#: Dots that are so far past each other belong to lips that meet.
_PASSED_MM = 0.8


@dataclass(frozen=True, slots=True)
class Kink:
    """The point of ladders (poses that close the lips in steps) from which lips come no nearer.

    at_mm: (n_ladders,), the predicted closing there; left: the slope of apertures beyond the kink
    as a share of that before; left_sd: its standard error; explained: how much better the kink fits
    than a straight line, in square standard errors.
    """

    at_mm: tuple[float, ...]
    left: float
    left_sd: float
    explained: float

    @property
    def is_contact(self) -> bool:
        """Whether the kink is beyond doubt and the slope after it small, so that lips touch."""
        return self.explained > _SURE_EVIDENCE and self.left + 2.0 * self.left_sd < _MOST_SLOPE_LEFT


def find_kink(closes_mm: Sequence[Array], apertures_mm: Sequence[Array], noise_mm: float) -> Kink:
    """Return the kink of ladders: the step from which lips come no nearer, though joints go on.

    A ladder is a series of poses that close the lips step by step; one kink is fitted to all.

    Parameters
    ----------
    closes_mm : Sequence[Array]
        (n,) mm each: predicted closing of the ladder's steps, ascending from 0.
    apertures_mm : Sequence[Array]
        (n,) mm each: measured apertures of the lips.
    noise_mm : float
        Standard error of an aperture, in mm.

    Returns
    -------
    Kink
        Its position on each ladder, in mm, with the evidence.
    """
    kinks = [_kink(x, y / noise_mm, noise_mm) for x, y in zip(closes_mm, apertures_mm, strict=True)]
    # Slopes beyond the kinks are averaged by the inverse of their variance.
    weights = np.array([kink[3] for kink in kinks])
    slopes_left = np.array([kink[2] for kink in kinks])
    total_weight = max(float(weights.sum()), 1e-9)
    return Kink(
        at_mm=tuple(kink[0] for kink in kinks),
        left=float((weights * slopes_left).sum() / total_weight),
        left_sd=1.0 / np.sqrt(total_weight),
        explained=float(sum(kink[1] for kink in kinks)),
    )


def _kink(x: Array, y: Array, noise_mm: float) -> tuple[float, float, float, float]:
    """Return one ladder's kink: position in mm, evidence, slope beyond it, and 1 / slope variance.

    x: (n,), predicted closing in mm; y: (n,), apertures in standard errors, each of noise_mm. The
    evidence is by how much the kink reduces the squared residuals of a straight line, 0 at least;
    the slope is given as a share of the slope before the kink.
    """
    straight_cost = _line_fit(np.column_stack([np.ones_like(x), -x / noise_mm]), y)[0]
    best = (float(x[-1]), 0.0, 1.0, 0.0)
    for kink_mm in np.arange(x[0] + 0.3, x[-1] - 0.3, 0.1):
        before, beyond = np.minimum(x, kink_mm), np.maximum(x - kink_mm, 0.0)
        inputs = np.column_stack([np.ones_like(x), -before / noise_mm, -beyond / noise_mm])
        cost, slopes, variance = _line_fit(inputs, y)
        if straight_cost - cost > best[1]:
            slope_left = slopes[2] / max(slopes[1], 0.2)
            # 1 / variance of the ratio of both slopes, by their own variances.
            weight = slopes[1] ** 2 / max(variance[2, 2] + slope_left**2 * variance[1, 1], 1e-9)
            best = (float(kink_mm), straight_cost - cost, float(slope_left), float(weight))
    return best


def _line_fit(inputs: Array, y: Array) -> tuple[float, Array, Array]:
    """Return the least-squares fit of `y` by `inputs`, with a prior for the first slope.

    That slope, of the second column of `inputs`, is drawn towards 1. The result is the sum of
    squared residuals, the parameters, and their covariance for unit noise variance (`y` is in
    standard errors).
    """
    prior = np.zeros((1, inputs.shape[1]))
    prior[0, 1] = 1.0 / _SLOPE_SD
    all_inputs = np.vstack([inputs, prior])
    all_y = np.append(y, 1.0 / _SLOPE_SD)
    covariance = np.linalg.pinv(all_inputs.T @ all_inputs)
    parameters = covariance @ all_inputs.T @ all_y
    return float(np.sum((all_inputs @ parameters - all_y) ** 2)), parameters, covariance


@dataclass(frozen=True, slots=True)
class SeenLadders:
    """What a capture's ladders, poses that close the lips step by step, show of contact.

    rows: rows of the capture, for each ladder in the order of its steps; touching: (n,), poses of
    the capture beyond the kink; passed: whether dots of upper and lower lip passed one another.
    """

    rows: tuple[NDArray[np.int64], ...]
    kink: Kink
    touching: NDArray[np.bool_]
    passed: bool

    @property
    def meet(self) -> bool:
        """Whether there is evidence that the lips meet: a kink by contact, or dots that passed."""
        return self.passed or self.kink.is_contact


@dataclass(frozen=True, slots=True)
class Apertures:
    """Heights between upper and lower lip in the steps of ladders, less each ladder's median.

    A ladder is a series of poses that close the lips step by step. rows: rows of the capture, for
    each ladder in the order of its steps; mm: these heights, the mean of all pairs, (n_steps,)
    each; pairs: marker numbers of the compared dots; share: noise of the mean over that of one
    marker; last_mm: middle gap in the last steps.
    """

    rows: tuple[NDArray[np.int64], ...]
    mm: tuple[Array, ...]
    pairs: tuple[tuple[int, int], ...]
    share: float
    last_mm: float


def ladder_apertures(capture: Capture) -> Apertures | None:
    """Return the lips' apertures in a capture's ladders, poses that close the lips in steps.

    None without ladders or without dots on both lips.
    """
    ladders, names = ladders_of(capture), capture.marker_names
    pairs = tuple((names.index(a), names.index(b)) for a, b in _OPPOSITE if {a, b} <= set(names))
    rows = [np.flatnonzero(ladders == ladder) for ladder in np.unique(ladders[ladders > 0])]
    rows = [steps for steps in rows if len(steps) >= _FEWEST_STEPS]
    if not rows or not pairs:
        return None
    apertures_mm, last_mm = [], []
    for steps in rows:
        heights_mm = gap_heights_mm(capture.markers_mm[steps], pairs)
        # A dot that is lost in one step must not shift the mean of the others.
        usual_mm = np.nanmedian(heights_mm, axis=0)
        apertures_mm.append(np.nan_to_num(np.nanmean(heights_mm - usual_mm, axis=1)))
        last_mm.append(heights_mm[-2:, 0])
    share = float(np.sqrt(2.0 / len(pairs)))
    return Apertures(tuple(rows), tuple(apertures_mm), pairs, share, float(np.nanmean(last_mm)))


def read_ladders(capture: Capture, markers_of: _MarkersOf, noise_mm: float) -> SeenLadders | None:
    """Return what a capture's ladders, poses that close the lips in steps, show of contact.

    None without ladders or without dots on both lips. markers_of: the face learnt so far, from
    poses (k, n_servos) degrees to markers in mm; noise_mm: of a marker in one axis.
    """
    seen = ladder_apertures(capture)
    if seen is None:
        return None
    closes_mm = []
    for steps in seen.rows:
        mm_per_deg = pair_slopes(markers_of, capture.goals_deg[steps[0]], seen.pairs).mean(axis=0)
        # How far each step should close the lips, by a straight line from the ladder's first pose.
        closes_mm.append(-(capture.goals_deg[steps] - capture.goals_deg[steps[0]]) @ mm_per_deg)
    kink = find_kink(closes_mm, seen.mm, seen.share * noise_mm)
    touching = np.zeros(len(capture), dtype=bool)
    if kink.is_contact:
        for steps, closing_mm, kink_mm in zip(seen.rows, closes_mm, kink.at_mm, strict=True):
            touching[steps[closing_mm > kink_mm]] = True
    return SeenLadders(seen.rows, kink, touching, passed=seen.last_mm < -_PASSED_MM)
