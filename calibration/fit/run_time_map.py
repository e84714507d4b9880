"""The regression that runs live: from coefficients to servo angles, fitted to solved poses.

Angles are fitted where they show: errors are weighted by their effect on the lips at that pose, so
that two servos that part the lips together err together. Its kind, quadratic or with bends, is
chosen on frames left out of the fit.
Loads scikit-learn; the live path never does.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from sklearn.cluster import KMeans

from calibration.calibration import distances, free_angles_deg
from calibration.closure import Closure, pairs
from calibration.fit.retargeting import (
    MarkersOf,
    Retargeting,
    RobotMouth,
    ShapeFeatures,
    gap_heights_mm,
    shape_slopes,
)
from lipsync.arrays import Array

#: Poses are noisy by a few tenths of a degree where the face hardly shows a joint; this keeps the
#: quadratic terms from following that. In degrees per unit of a standardised feature, squared.
_RIDGE = 3.0
#: With centres the features are many and alike: a weaker ridge, as strong on what is smooth.
_RIDGE_WITH_CENTRES = 0.1
#: Degrees that count as much as a weighted millimetre: also joints that show little stay tame.
_ANGLE_WEIGHT_MM_PER_DEG = 0.05
#: The file keeps this many digits, so the fit does as well and its errors are those of the file.
SIGNIFICANT_DIGITS = 6


@dataclass(frozen=True, slots=True)
class RunTimeMap:
    """The parts of a calibration that map coefficients to angles, shaped as in `Calibration`."""

    rest_deg: Array
    weights: Array
    quadratic_weights: Array
    x_range: Array
    centres: Array
    centre_weights: Array
    closure: Closure | None = None

    def poses_deg(self, from_rest: Array, mouth: RobotMouth) -> Array:
        """Return the poses that this map gives, within limits and coupling rules.

        The poses include the correction that makes lips meet, if the map has one.

        Parameters
        ----------
        from_rest : Array
            (n, n_components) mm, coefficients less the rest.
        mouth : RobotMouth
            Mouth with the limits and rules.

        Returns
        -------
        Array
            (n, n_servos) degrees.
        """
        poses_deg = np.clip(self.free_deg(from_rest), *mouth.limits_deg)
        if self.closure is not None:
            x = np.clip(from_rest, *self.x_range)
            poses_deg = self.closure.corrected_deg(x, poses_deg, *mouth.limits_deg)
        return mouth.limited_deg(poses_deg)

    def without(self, still: Sequence[int]) -> "RunTimeMap":
        """Return a map whose joints numbered in `still` are at 0 degrees for every wanted face."""
        if not still:
            return self
        moves = np.ones((len(self.rest_deg), 1))
        moves[list(still)] = 0.0
        closure = self.closure
        if closure is not None:
            closure = replace(closure, turns_deg=closure.turns_deg * moves)
        return replace(
            self,
            rest_deg=self.rest_deg * moves[:, 0],
            weights=self.weights * moves,
            quadratic_weights=self.quadratic_weights * moves,
            centre_weights=self.centre_weights * moves,
            closure=closure,
        )

    def free_deg(self, from_rest: Array) -> Array:
        """Return the live angles, before the correction that makes lips meet, limits and rules.

        Parameters
        ----------
        from_rest : Array
            (n, n_components) mm, coefficients less the rest.

        Returns
        -------
        Array
            (n, n_servos) degrees.
        """
        x = np.clip(from_rest, *self.x_range)
        return free_angles_deg(
            x, self.rest_deg, self.weights, self.quadratic_weights, self.centres,
            self.centre_weights,
        )  # fmt: skip


def fit_run_time_map(
    from_rest: Array,
    poses_deg: Array,
    markers_of: MarkersOf,
    shape_features: ShapeFeatures,
    centres: Array | None = None,
    counts: Array | None = None,
) -> RunTimeMap:
    """Return the live map fitted to poses by generalised least squares.

    The cost of angle errors (metric) is the mean of J'J over the poses, J the slopes of the shape
    features. With one metric for all frames the solution depends on it only by the ridge, so each
    principal direction of the metric is regressed on its own, with a ridge in inverse proportion
    to how much that direction shows.

    Parameters
    ----------
    from_rest : Array
        (n, n_components) mm, coefficients less the rest.
    poses_deg : Array
        (n, n_servos) degrees, the pose wanted for each.
    markers_of : MarkersOf
        Function from poses (n, n_servos) degrees to markers (n, n_markers, 3) mm.
    shape_features : ShapeFeatures
        Weights of the shapes' features.
    centres : Array | None
        (n_centres, n_components) of bends that are not quadratic; None: no such bends.
    counts : Array | None
        (n,), weight of each frame; None: all alike.

    Returns
    -------
    RunTimeMap
        Map rounded to the digits of the calibration file.
    """
    first, second = pairs(from_rest.shape[1])
    n_components = from_rest.shape[1]
    centres = np.zeros((0, n_components)) if centres is None else rounded(centres)
    x_range = rounded(np.array([from_rest.min(axis=0), from_rest.max(axis=0)]))
    products = from_rest[:, first] * from_rest[:, second]
    # Inputs: coefficients, their products and distances from the centres, standardised, less their
    # weighted mean.
    features = np.hstack([from_rest, products, distances(from_rest, centres)])
    feature_mean, feature_sd = features.mean(axis=0), features.std(axis=0) + 1e-12
    inputs = (features - feature_mean) / feature_sd
    counts = np.ones(len(inputs)) if counts is None else counts / counts.mean()
    mean_input = np.average(inputs, axis=0, weights=counts)
    inputs, weighted = inputs - mean_input, (inputs - mean_input) * counts[:, None]
    ridge_strength = _RIDGE if not len(centres) else _RIDGE_WITH_CENTRES
    sizes, directions = np.linalg.eigh(_angle_metric(poses_deg, markers_of, shape_features))
    # Angles in the coordinates of the metric's principal directions.
    outputs = poses_deg @ directions
    mean_output = np.average(outputs, axis=0, weights=counts)
    solved = np.empty((inputs.shape[1], outputs.shape[1]))
    for k, size in enumerate(sizes):
        ridge = ridge_strength * max(1.0, sizes[-1] / size / 100.0)
        normal = weighted.T @ inputs + ridge * np.eye(inputs.shape[1])
        solved[:, k] = np.linalg.solve(normal, weighted.T @ (outputs[:, k] - mean_output[k]))
    # Back to angles per unscaled feature.
    slopes = (solved / feature_sd[:, None]) @ directions.T
    rest_deg = mean_output @ directions.T - (feature_mean + feature_sd * mean_input) @ slopes
    n_quadratic = n_components + len(first)
    return RunTimeMap(
        rest_deg=rounded(rest_deg),
        weights=rounded(slopes[:n_components].T),
        quadratic_weights=rounded(slopes[n_components:n_quadratic].T),
        x_range=x_range,
        centres=centres,
        centre_weights=rounded(slopes[n_quadratic:].T),
    )


def rounded(values: Array) -> Array:
    """Return values rounded to the significant digits of the calibration file.

    Parameters
    ----------
    values : Array
        Any shape.

    Returns
    -------
    Array
        Rounded values, shaped as the argument.
    """
    kept = [float(f"{value:.{SIGNIFICANT_DIGITS}g}") for value in values.ravel()]
    return np.array(kept).reshape(values.shape)


def _angle_metric(poses_deg: Array, markers_of: MarkersOf, shape_features: ShapeFeatures) -> Array:
    """Return the mean cost of angle errors, (n_servos, n_servos) weighted mm^2 per deg^2.

    It is the effect of angles on the shape features, averaged over poses_deg.
    """
    n_servos = poses_deg.shape[1]
    features = shape_features.of(markers_of(poses_deg))
    slopes = shape_slopes(markers_of, shape_features, poses_deg, features)
    metric = np.einsum("nks,nkt->st", slopes, slopes) / len(poses_deg)
    return np.asarray(metric + _ANGLE_WEIGHT_MM_PER_DEG**2 * np.eye(n_servos))


#: A map with bends around so many of the speaker's mouths, or a quadratic one.
_N_CENTRES = 40
_LEARN_SHARE = 0.8
#: A frame in which the speaker closes counts as so many others: a closure that is missed shows.
_CLOSURE_COUNTS = 6.0
#: What a degree costs against a millimetre where the lips are made to meet: joints that show little
#: stay tame.
_TURN_MM_PER_DEG = 0.1


def choose_map(retargeting: Retargeting, from_rest: Array) -> RunTimeMap:
    """Return the better of two kinds of map: quadratic, or with bends that are not quadratic.

    Both are fitted to the first four fifths of the frames and compared on the rest, by lip gap and
    shape.

    Parameters
    ----------
    retargeting : Retargeting
        The learnt face.
    from_rest : Array
        (n, n_components) mm from rest: recorded motions of single phonemes, joined.

    Returns
    -------
    RunTimeMap
        Map fitted to all frames.
    """
    poses_deg = retargeting.poses_deg(from_rest)
    closure = fit_closure(retargeting, from_rest, poses_deg)
    n_fitted = round(_LEARN_SHARE * len(from_rest))
    centres_tried = [None, _bend_centres(from_rest)]
    losses = []
    for centres in centres_tried:
        run = _fit_map(retargeting, from_rest[:n_fitted], poses_deg[:n_fitted], centres)
        run = replace(run, closure=closure)
        losses.append(_loss(retargeting, run, from_rest[n_fitted:], poses_deg[n_fitted:]))
    centres = centres_tried[int(np.argmin(losses))]
    return replace(_fit_map(retargeting, from_rest, poses_deg, centres), closure=closure)


def fit_closure(retargeting: Retargeting, from_rest: Array, poses_deg: Array) -> Closure | None:
    """Return the correction that makes lips meet, a quadratic of the joints about closed poses.

    Parameters
    ----------
    retargeting : Retargeting
        The learnt face.
    from_rest : Array
        (n, n_components) mm, coefficients less the rest.
    poses_deg : Array
        (n, n_servos) degrees, the pose wanted for each.

    Returns
    -------
    Closure | None
        None where the speaker's lips never close.
    """
    is_closed = retargeting.closing(from_rest) >= 1.0
    if not is_closed.any():
        return None
    model, mouth = retargeting.model, retargeting.mouth
    shape = mouth.names.shape_features
    n_components = from_rest.shape[1]
    rest_mm = model.markers_mm(model.rest[None])
    moved_mm = model.markers_mm(model.rest + np.eye(n_components)) - rest_mm
    # The speaker's vector between the lips at rest, and after one mm of each coefficient.
    between_mm = model.layout.gap_vectors_mm(np.concatenate([rest_mm, rest_mm + moved_mm]))
    if not model.layout.has_inner_lips:
        between_mm = between_mm - model.lips_touching_mm
    opens_mm = gap_heights_mm(retargeting.scale * moved_mm[:, list(mouth.names.human)], shape.gaps)
    at_deg = poses_deg[is_closed].mean(axis=0)

    def open_mm(moved_deg: Array) -> Array:
        return gap_heights_mm(mouth.markers_of(at_deg + moved_deg), shape.gaps)

    n_servos = len(at_deg)
    first, second = pairs(n_servos)
    one_deg = np.eye(n_servos)
    gaps_closed, more, less = open_mm(np.zeros((1, n_servos))), open_mm(one_deg), open_mm(-one_deg)
    # Slopes, squares and products of the joints by differences of one degree about the closed pose.
    both = open_mm(one_deg[first] + one_deg[second])
    cross_terms = both - more[first] - more[second] + gaps_closed
    square_terms = (more + less) / 2 - gaps_closed
    bends = np.where((first == second)[:, None], square_terms[first], cross_terms)
    slopes = (more - less).T / 2
    # Turns that open one gap at the least cost: the regularised inverse of the slopes.
    turns_deg = slopes.T @ np.linalg.inv(
        slopes @ slopes.T + _TURN_MM_PER_DEG**2 * np.eye(len(slopes))
    )
    return Closure(
        speaker_mm=rounded((between_mm[1:] - between_mm[0]).T),
        speaker_rest_mm=rounded(between_mm[0]),
        opens_mm=rounded(opens_mm.T),
        at_deg=rounded(at_deg),
        gaps_mm=rounded(gaps_closed[0] - retargeting.closed_mm),
        slopes=rounded(slopes),
        bends=rounded(bends.T),
        turns_deg=rounded(turns_deg),
        press_mm=retargeting.press_mm,
    )


def _bend_centres(from_rest: Array) -> Array | None:
    """Return the centres of clusters of frames, (_N_CENTRES, n_components); None for few frames."""
    if len(np.unique(from_rest, axis=0)) < 4 * _N_CENTRES:
        return None
    clusters = KMeans(_N_CENTRES, n_init=1, random_state=0).fit(from_rest)
    return np.asarray(clusters.cluster_centers_, dtype=np.float64)


def _fit_map(
    retargeting: Retargeting, from_rest: Array, poses_deg: Array, centres: Array | None
) -> RunTimeMap:
    """Return the live map fitted to poses; frames with closed lips count up to six times.

    from_rest: (n, n_components) mm; poses_deg: (n, n_servos) degrees; centres: as in
    `fit_run_time_map`.
    """
    mouth = retargeting.mouth
    counts = 1.0 + (_CLOSURE_COUNTS - 1.0) * retargeting.closing(from_rest)
    return fit_run_time_map(
        from_rest, poses_deg, mouth.markers_of, mouth.names.shape_features, centres, counts
    )


def _loss(retargeting: Retargeting, run: RunTimeMap, from_rest: Array, poses_deg: Array) -> float:
    """Return the mean squared difference of shape features between best poses and those of a map.

    poses_deg: the best poses for the frames from_rest; run: the map.
    """
    mouth = retargeting.mouth
    features = mouth.names.shape_features
    made = features.of(mouth.seen_mm(run.poses_deg(from_rest, mouth)))
    return float(np.mean((made - features.of(mouth.seen_mm(poses_deg))) ** 2))
