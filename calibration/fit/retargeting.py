"""From the speaker's mouth to this robot's: the wanted shape, and the robot pose nearest to it.

Markers correspond by name. The wanted gap of the lips is the robot's own closed gap plus scale
times (the speaker's gap less the speaker's closed gap); scale is the ratio of the widest gaps of
the two, at most 1.3. The rest of the mouth is the speaker's motion at that scale, laid on the
robot's neutral. A skin drawn by a few horns cannot copy a speaker's point by point, so the target
shape is that of the robot's own nearest pose, found by bounded least squares, many at once; lip
gaps weigh most. Only where the speaker's lips close do the robot's go past contact, by as much as
the learnt gap may be wrong there: more is force, not closure.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calibration.calibration import CalibrationError, CouplingRule, keep_rules
from calibration.closure import BLEND_MM, CLOSED_GAP_MM
from lipsync.arrays import Array
from lipsync.face.model import FaceModel
from lipsync.markers import MARKERS_47

#: (n, n_servos) degrees -> (n, n_markers, 3) millimetres.
MarkersOf = Callable[[Array], Array]

#: Weights of a millimetre: lips are looked at, cheeks and chin only help; whether lips touch shows
#: most, so the lip gaps count on top of the lips themselves.
_LIP_WEIGHT, _SKIN_WEIGHT, _GAP_WEIGHT = 1.0, 0.3, 4.0
#: Millimetres a degree away from neutral is worth: decides between poses that look the same. From
#: 0.005 to 0.05 no error on grid_s1 changes by 0.005 mm.
NEUTRAL_WEIGHT_MM_PER_DEG = 0.02
#: A millimetre for each degree by which a coupling rule is broken: more than the lips weigh.
_RULE_WEIGHT_MM_PER_DEG = 5.0
#: Enough for angles within 0.001 degree of where they would end, measured on grid_s1.
_GAUSS_NEWTON_STEPS = 4
_MOST_SWEEPS = 60
_SETTLED_DEG = 1e-7
_DIFFERENCE_DEG = 0.5


@dataclass(frozen=True, slots=True)
class ShapeFeatures:
    """Weighted features of a shape. lips: marker indices; gaps: (n_gaps, 2), upper and lower."""

    lips: tuple[int, ...]
    gaps: tuple[tuple[int, int], ...]

    def of(self, markers_mm: Array, gaps_mm: Array | None = None) -> Array:
        """Return the features of shapes: weighted positions, then weighted lip gaps.

        Parameters
        ----------
        markers_mm : Array
            (n, n_markers, 3) mm.
        gaps_mm : Array | None
            (n, n_gaps, 3) mm, wanted gaps; None: those of the markers.

        Returns
        -------
        Array
            (n, n_features), weighted mm.
        """
        weight = np.full((markers_mm.shape[1], 1), _SKIN_WEIGHT)
        weight[list(self.lips)] = _LIP_WEIGHT
        if gaps_mm is None:
            gaps_mm = self.gaps_mm(markers_mm)
        parts = (weight * markers_mm, _GAP_WEIGHT * gaps_mm)
        return np.concatenate([part.reshape(len(markers_mm), -1) for part in parts], axis=1)

    def gaps_mm(self, markers_mm: Array) -> Array:
        """Return the lip gaps as vectors: upper minus lower marker.

        Parameters
        ----------
        markers_mm : Array
            (n, n_markers, 3) mm.

        Returns
        -------
        Array
            (n, n_gaps, 3) mm.
        """
        upper, lower = ([pair[i] for pair in self.gaps] for i in (0, 1))
        return np.asarray(markers_mm[:, upper] - markers_mm[:, lower])


def gap_heights_mm(markers_mm: Array, gaps: tuple[tuple[int, int], ...]) -> Array:
    """Return how far upper markers are above lower ones, by the vertical axis alone.

    Parameters
    ----------
    markers_mm : Array
        (n, n_markers, 3) mm.
    gaps : tuple[tuple[int, int], ...]
        Upper and lower marker numbers.

    Returns
    -------
    Array
        (n, n_gaps) mm.
    """
    upper, lower = ([pair[i] for pair in gaps] for i in (0, 1))
    return np.asarray(markers_mm[:, upper, 1] - markers_mm[:, lower, 1])


def shape_slopes(
    markers_of: MarkersOf, shape_features: ShapeFeatures, angles_deg: Array, reached: Array
) -> Array:
    """Return the change of shape features per degree of each joint, by forward differences.

    Parameters
    ----------
    markers_of : MarkersOf
        Function from poses (n, n_servos) degrees to markers (n, n_markers, 3) mm.
    shape_features : ShapeFeatures
        Weights of the shapes' features.
    angles_deg : Array
        (n, n_servos) degrees.
    reached : Array
        (n, n_features), features at angles_deg.

    Returns
    -------
    Array
        (n, n_features, n_servos), weighted mm per degree.
    """
    n, n_servos = angles_deg.shape
    stepped_deg = angles_deg[:, None] + _DIFFERENCE_DEG * np.eye(n_servos)
    features = shape_features.of(markers_of(stepped_deg.reshape(-1, n_servos)))
    changes = features.reshape(n, n_servos, -1) - reached[:, None]
    return np.asarray(changes.transpose(0, 2, 1) / _DIFFERENCE_DEG)


def bounded_minimum(matrices: Array, rights: Array, lower: Array, upper: Array) -> Array:
    """Return the x that minimises x'Ax/2 - b'x with lower <= x <= upper, for n problems at once.

    By coordinate descent: each coordinate in turn is set to its own bounded minimum.

    Parameters
    ----------
    matrices : Array
        (n, k, k): A, positive definite.
    rights : Array
        (n, k): b.
    lower,upper : Array
        (k,): bounds of x.

    Returns
    -------
    Array
        (n, k): x.
    """
    free = np.linalg.solve(matrices, rights[..., None])[..., 0]
    x = np.clip(free, lower, upper)
    # Problems whose free minimum is within the bounds are solved; the others go on.
    bound_rows = np.flatnonzero((x != free).any(axis=1))
    matrices, rights, x_bound = matrices[bound_rows], rights[bound_rows], x[bound_rows]
    columns = [np.ascontiguousarray(matrices[:, i]) for i in range(len(lower))]
    for _ in range(_MOST_SWEEPS):
        x_before = x_bound.copy()
        for i, column in enumerate(columns):
            gradient = (column * x_bound).sum(axis=1) - rights[:, i]
            unbounded = x_bound[:, i] - gradient / column[:, i]
            x_bound[:, i] = np.minimum(np.maximum(unbounded, lower[i]), upper[i])
        if np.abs(x_bound - x_before).max(initial=0.0) < _SETTLED_DEG:
            break
    x[bound_rows] = x_bound
    return np.asarray(x)


#: Upper and lower; the middle one says how open a mouth is.
_GAP_NAMES = (
    ("inner_lip_13", "inner_lip_14"),
    ("inner_lip_82", "inner_lip_87"),
    ("inner_lip_312", "inner_lip_317"),
)
_MIDDLE_GAP = _GAP_NAMES[0]
_CORNERS = ("outer_lip_61", "outer_lip_291")
#: Without these nobody knows how open and how wide a mouth is.
LIPS_NEEDED = frozenset((*_MIDDLE_GAP, *_CORNERS))


@dataclass(frozen=True, slots=True)
class Correspondence:
    """The robot's markers that the speaker's model has, too.

    human: indices into the model's markers, in the robot's order; corners: the robot's indices of
    right and left lip corner.
    """

    marker_names: tuple[str, ...]
    human: tuple[int, ...]
    shape_features: ShapeFeatures
    corners: tuple[int, int]


def correspond(marker_names: Sequence[str]) -> Correspondence:
    """Return the correspondence of the robot's markers with the speaker's, by equal names.

    Raises CalibrationError for names that the speaker's model lacks, or without the middle and the
    corners of the lips, which define how open and how wide a mouth is.
    """
    names = tuple(marker_names)
    unknown = [name for name in names if name not in MARKERS_47.names]
    if unknown:
        raise CalibrationError(
            f"unknown marker {unknown[0]!r}; use one of: {', '.join(MARKERS_47.names)}"
        )
    for name in (*_MIDDLE_GAP, *_CORNERS):
        if name not in names:
            raise CalibrationError(f"marker {name!r} is needed but was not captured; add it")
    human = tuple(MARKERS_47.names.index(name) for name in names)
    lips = tuple(i for i, h in enumerate(human) if h in MARKERS_47.lips)
    gaps = tuple(
        (names.index(upper), names.index(lower))
        for upper, lower in _GAP_NAMES
        if upper in names and lower in names
    )
    right, left = (names.index(name) for name in _CORNERS)
    return Correspondence(names, human, ShapeFeatures(lips, gaps), (right, left))


@dataclass(frozen=True, slots=True)
class RobotMouth:
    """A learnt mouth: markers by pose, features of its shape, joint limits and coupling rules.

    stopped_of: the markers with lips that stop each other, which overlap in markers_of;
    None: the same as markers_of.
    """

    markers_of: MarkersOf
    names: Correspondence
    limits_deg: tuple[Array, Array]
    rules: tuple[CouplingRule, ...] = ()
    stopped_of: MarkersOf | None = None

    def seen_mm(self, poses_deg: Array) -> Array:
        """Return the markers of poses as a tracker would measure them, lips stopping each other.

        Parameters
        ----------
        poses_deg : Array
            (n, n_servos) degrees.

        Returns
        -------
        Array
            (n, n_markers, 3) mm.
        """
        return (self.stopped_of or self.markers_of)(poses_deg)

    def neutral_mm(self) -> Array:
        """Return the markers with all joints at 0.

        Returns
        -------
        Array
            (n_markers, 3) mm.
        """
        return np.asarray(self.markers_of(np.zeros((1, len(self.limits_deg[0]))))[0])

    def nearest_deg(self, wanted: Array) -> Array:
        """Return the poses whose shapes are nearest to wanted ones, by Gauss-Newton from neutral.

        They are within the limits and keep the rules.

        Parameters
        ----------
        wanted : Array
            (n, n_features), weighted mm, of the wanted shapes.

        Returns
        -------
        Array
            (n, n_servos) degrees.
        """
        shape_features, n_servos = self.names.shape_features, len(self.limits_deg[0])
        angles_deg = np.zeros((len(wanted), n_servos))
        turn_cost = NEUTRAL_WEIGHT_MM_PER_DEG**2 * np.eye(n_servos)
        for _ in range(_GAUSS_NEWTON_STEPS):
            reached = shape_features.of(self.markers_of(angles_deg))
            slopes = shape_slopes(self.markers_of, shape_features, angles_deg, reached)
            # Linear about the current angles: the new ones should make `slopes @ angles` this
            # target.
            target = wanted - reached + (slopes @ angles_deg[..., None])[..., 0]
            transposed = slopes.transpose(0, 2, 1)
            normal = transposed @ slopes + turn_cost
            right = (transposed @ target[..., None])[..., 0]
            for rule in self.rules:
                # A broken rule, at the current angles, pulls the weighted sum back to its limit.
                is_broken = angles_deg @ rule.weights > rule.at_most_deg
                penalty = is_broken * _RULE_WEIGHT_MM_PER_DEG**2
                normal += penalty[:, None, None] * np.outer(rule.weights, rule.weights)
                right += penalty[:, None] * rule.weights * rule.at_most_deg
            angles_deg = bounded_minimum(normal, right, *self.limits_deg)
        return angles_deg

    def limited_deg(self, free_deg: Array) -> Array:
        """Return poses limited to the joint ranges and coupling rules, (n, n_servos) degrees.

        Parameters
        ----------
        free_deg : Array
            (n, n_servos) degrees.
        """
        within_deg: Array = np.clip(free_deg, *self.limits_deg)
        if not self.rules:
            return within_deg
        return np.array([keep_rules(self.rules, degrees) for degrees in within_deg])


#: Where nobody saw lips stop each other they are asked to go so far past the closed gap.
PRESS_MM = 1.2
#: The speaker's range that is matched; more is rare and would make everything else small.
_RANGE_QUANTILE = 0.98
#: A robot may exaggerate its speaker by this factor, not more: a jaw that can drop by 30 degrees
#: does not do so at every vowel (design).
MOST_EXAGGERATION = 1.3
#: Rounds in which the gap that was missed at closures is asked for on top.
_CLOSING_ROUNDS = 3
#: A mouth smaller than this, or one that opens less, is no mouth but a mistake.
_LEAST_WIDTH_MM, LEAST_OPENING_MM = 10.0, 1.5


@dataclass(frozen=True, slots=True)
class Retargeting:
    """A conversion of the shapes of a speaker's mouth into shapes and poses of a robot's mouth.

    closed_mm: (n_gaps,), heights between lip dots when lips touch; scale: robot's motion over the
    speaker's; press_mm: how far past contact lips go where the speaker's close.
    """

    model: FaceModel
    mouth: RobotMouth
    scale: float
    closed_mm: Array
    press_mm: float

    def poses_deg(self, from_rest: Array) -> Array:
        """Return the nearest poses, lips closed where the speaker's are, (n, n_servos) degrees.

        Where lips close, the gap aimed at is corrected by the error of the nearest pose, in three
        rounds, as the search weighs gaps against the rest of the shape.

        Parameters
        ----------
        from_rest : Array
            (n, n_components) mm, coefficients less the rest.
        """
        # The speaker's scaled motion on the robot's neutral, and the gaps wanted instead of its
        # own.
        copies_mm, gaps_mm = self.copies_mm(from_rest)
        features = self.mouth.names.shape_features
        poses_deg = self.mouth.nearest_deg(features.of(copies_mm, gaps_mm))
        closed = self.closing(from_rest) >= 1.0
        if closed.any():
            aimed_mm = gaps_mm[closed].copy()
            for _ in range(_CLOSING_ROUNDS):
                reached_mm = gap_heights_mm(self.mouth.markers_of(poses_deg[closed]), features.gaps)
                aimed_mm[..., 1] += gaps_mm[closed][..., 1] - reached_mm
                poses_deg[closed] = self.mouth.nearest_deg(features.of(copies_mm[closed], aimed_mm))
        return poses_deg

    def targets_mm(self, from_rest: Array) -> Array:
        """Return the robot's own shapes nearest to the speaker's, (n, n_markers, 3) mm.

        Closed lips just meet in them: a change of shape by pressing counts as an error.

        Parameters
        ----------
        from_rest : Array
            (n, n_components) mm, coefficients less the rest.
        """
        return self.mouth.seen_mm(replace(self, press_mm=0.0).poses_deg(from_rest))

    def at_gap(self, from_rest: Array, gap_mm: float) -> Array:
        """Return the pose nearest to a shape, with the lips' middle gap at a given height.

        Parameters
        ----------
        from_rest : Array
            (1, n_components) mm, coefficients less the rest.
        gap_mm : float
            Height of the middle gap in the pose.

        Returns
        -------
        Array
            (1, n_servos) degrees.
        """
        shifted = replace(self, closed_mm=self.closed_mm - self.closed_mm[0] + gap_mm, press_mm=0.0)
        return shifted.poses_deg(from_rest)

    def closing(self, from_rest: Array) -> Array:
        """Return how far the speaker's lips are closed, by the gap between them.

        Parameters
        ----------
        from_rest : Array
            (n, n_components) mm, coefficients less the rest.

        Returns
        -------
        Array
            (n,): 1 closed, 0 open, blended between.
        """
        gaps_mm = self.model.lip_gaps_mm(self.model.markers_mm(from_rest + self.model.rest))
        return np.asarray(np.clip(1.0 - (gaps_mm - CLOSED_GAP_MM) / BLEND_MM, 0.0, 1.0))

    def wanted_open_mm(self, from_rest: Array) -> Array:
        """Return the wanted openings beyond the robot's closed gap, never negative, (n, n_gaps) mm.

        Parameters
        ----------
        from_rest : Array
            (n, n_components) mm, coefficients less the rest.
        """
        return np.maximum(self.copies_mm(from_rest)[1][..., 1] - self.closed_mm, 0.0)

    def copies_mm(self, from_rest: Array) -> tuple[Array, Array]:
        """Return the speaker's scaled motion laid on the robot's neutral, and the wanted gaps.

        Parameters
        ----------
        from_rest : Array
            (n, n_components) mm, coefficients less the rest.

        Returns
        -------
        tuple[Array, Array]
            Markers (n, n_markers, 3) and gap vectors (n, n_gaps, 3) in mm.
        """
        names = self.mouth.names
        rest_mm = self.model.markers_mm(self.model.rest[None])
        moved_mm = self.model.markers_mm(from_rest + self.model.rest) - rest_mm
        moved_mm = self.scale * moved_mm[:, list(names.human)]
        neutral_mm = self.mouth.neutral_mm()[None]
        features = names.shape_features
        gaps_mm = features.gaps_mm(neutral_mm) + features.gaps_mm(moved_mm)
        closing = self.closing(from_rest)[:, None]
        opened_mm = np.maximum(features.gaps_mm(moved_mm)[..., 1], 0.0)
        # Heights: open lips as far as the speaker's motion goes, closed ones past contact.
        gaps_mm[..., 1] = self.closed_mm + (1.0 - closing) * opened_mm - closing * self.press_mm
        return neutral_mm + moved_mm, gaps_mm


def fit_retargeting(
    model: FaceModel, frames: Array, mouth: RobotMouth, closed_mm: Array, press_mm: float = PRESS_MM
) -> Retargeting:
    """Return a retargeting with the scale between speaker and robot fitted to their widest gaps.

    Parameters
    ----------
    model : FaceModel
        The speaker's face.
    frames : Array
        (n, n_components) mm, coefficients of recorded speech.
    mouth : RobotMouth
        The learnt robot.
    closed_mm : Array
        (n_gaps,) mm, heights between dots of lips that touch.
    press_mm : float
        How far past contact closures go.

    Returns
    -------
    Retargeting
        Fitted retargeting.

    Raises
    ------
    CalibrationError
        The corners are less than 10 mm apart, or the lips hardly part.
    """
    widest_mm = _check_mouth(mouth, closed_mm)
    speaker_range_mm = np.quantile(model.lip_gaps_mm(model.markers_mm(frames)), _RANGE_QUANTILE)
    speaker_range_mm -= model.lip_gap_mm(model.rest)
    scale = min(MOST_EXAGGERATION, widest_mm / max(float(speaker_range_mm), 1e-6))
    return Retargeting(model, mouth, scale, closed_mm, press_mm)


def _check_mouth(mouth: RobotMouth, closed_mm: Array) -> float:
    """Return how many mm the lips part at most; CalibrationError if corners or lips hardly part."""
    names = mouth.names.marker_names
    right, left = mouth.names.corners
    neutral_mm = mouth.neutral_mm()
    width_mm = float(neutral_mm[left, 0] - neutral_mm[right, 0])
    if width_mm < _LEAST_WIDTH_MM:
        raise CalibrationError(
            f"the mouth corners {names[right]} and {names[left]} are {width_mm:.1f} mm apart; "
            "check that they are the right points, in millimetres, with x to the robot's left"
        )
    widest_mm = mouth.markers_of(widest_pose_deg(mouth)[None])
    opening_mm = float(_middle_heights_mm(mouth, widest_mm)[0] - closed_mm[0])
    if opening_mm < LEAST_OPENING_MM:
        raise no_opening(mouth, opening_mm)
    return opening_mm


def no_opening(mouth: RobotMouth, opening_mm: float) -> CalibrationError:
    """Return the error for lips that part by only `opening_mm`, with the markers' names."""
    names = mouth.names.marker_names
    upper, lower = mouth.names.shape_features.gaps[0]
    return CalibrationError(
        f"the lips ({names[upper]}, {names[lower]}) open by {opening_mm:.1f} mm at most; check "
        "that these are the right points, and that a joint opens the mouth"
    )


def widest_pose_deg(mouth: RobotMouth) -> Array:
    """Return the pose with the highest middle gap, by setting each joint in turn to its best end.

    Parameters
    ----------
    mouth : RobotMouth
        Mouth of the learnt robot.

    Returns
    -------
    Array
        (n_servos,) degrees.
    """
    limits_deg = mouth.limits_deg
    n_servos = len(limits_deg[0])
    pose_deg = np.zeros((1, n_servos))
    # Twice over all joints, as the best end of one may depend on another.
    for joint in (*range(n_servos), *range(n_servos)):
        tries = np.repeat(pose_deg, 3, axis=0)
        tries[:, joint] = (limits_deg[0][joint], 0.0, limits_deg[1][joint])
        heights_mm = _middle_heights_mm(mouth, mouth.markers_of(mouth.limited_deg(tries)))
        pose_deg = tries[heights_mm.argmax()][None]
    return np.asarray(mouth.limited_deg(pose_deg)[0])


def _middle_heights_mm(mouth: RobotMouth, markers_mm: Array) -> Array:
    """Return the height of the middle lip gap of markers (n, n_markers, 3), as (n,) mm."""
    return gap_heights_mm(markers_mm, mouth.names.shape_features.gaps[:1])[:, 0]
