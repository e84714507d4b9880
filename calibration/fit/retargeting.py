"""From the speaker's mouth to this robot's: the same mouth, as this robot's skin can make it.

Markers correspond by name. First the speaker's motion is laid on the robot's neutral, larger or
smaller by one factor for each axis (`RangeMatch`): openings and widths of the speaker fill those of
the robot, and lips that touch, touch. A skin drawn by a few horns cannot copy a speaker's skin
point by point, so what the robot does at the poses nearest to that becomes the shape to aim for, a
linear function of the speaker's coefficients like the speaker's shapes themselves; lip gaps weigh
most.
"""

from dataclasses import dataclass

import numpy as np

from calibration.calibration import CalibrationError
from calibration.fit.correspondence import Correspondence, RobotMouth
from calibration.hold_out import CLOSED_GAP_MM
from lipsync.arrays import Array
from lipsync.face.model import FaceModel

#: Lips are asked to go so far past contact: soft lips are pressed a little, and a calibration that
#: is off by this much still closes. On development robots the gap of closed lips was 0.1 to 0.25 mm
#: larger than learnt, spread by 0.1 to 0.2 mm, and backlash added 0.1 to 0.2 mm.
PRESS_MM = 1.2
#: The speaker's range that is matched; more is rare and would make everything else small.
_RANGE_QUANTILE = 0.98
#: A robot may exaggerate its speaker by this factor over the ratio of their sizes, not more: its
#: range is used, but a jaw that can drop by 30 degrees does not do so at every vowel (design).
MOST_EXAGGERATION = 1.3
#: And it is asked for this share of what it can do, so that limits are met rarely.
_USED_SHARE = 0.9
#: The largest of these sizes is taken at which the learnt face comes within _FOLLOWED_MM of that
#: share of the shapes: less than the 0.5 mm that counts as reached, as the learnt face is not quite
#: the real one.
_SIZES = (1.0, 0.92, 0.85, 0.77, 0.69, 0.62, 0.54)
_FOLLOWED_MM, _FOLLOWED_SHARE = 0.35, 0.95
_FRAMES_TO_TRY = 200
#: A mouth smaller than this, or one that opens less, is no mouth but a mistake.
_LEAST_WIDTH_MM, _LEAST_OPENING_MM = 10.0, 1.5


@dataclass(frozen=True, slots=True)
class Retargeting:
    """target = neutral_mm + (coefficients - rest) @ slopes, a shape of the robot's markers.

    neutral_mm: (n_markers, 3), lips just closed; slopes: (n_components, n_markers * 3).
    scale: (3,), robot over speaker, across, up, forward. difference_mm: how far, rms over the lips,
    these shapes are from a copy of the speaker's at that scale.
    """

    neutral_mm: Array
    slopes: Array
    scale: Array
    difference_mm: float

    def targets_mm(self, from_rest: Array) -> Array:
        """(n, n_components) -> (n, n_markers, 3)."""
        return self.neutral_mm + (from_rest @ self.slopes).reshape(-1, *self.neutral_mm.shape)


def fit_retargeting(model: FaceModel, frames: Array, mouth: RobotMouth) -> Retargeting:
    """As large as the robot can follow. frames: (n, n_components), speech to serve."""
    widest = match_ranges(model.markers_mm(frames)[:, list(mouth.names.human)], mouth)
    some = np.linspace(0, len(frames) - 1, min(len(frames), _FRAMES_TO_TRY)).astype(int)
    for size in _SIZES:
        if _aim(model, frames[some], mouth, size * widest).followed >= _FOLLOWED_SHARE:
            break
    return _aim(model, frames, mouth, size * widest).retargeting


@dataclass(frozen=True, slots=True)
class _Aim:
    """A retargeting at one scale; followed: the part of the frames that the robot comes near to."""

    retargeting: Retargeting
    followed: float


def _aim(model: FaceModel, frames: Array, mouth: RobotMouth, scale: Array) -> _Aim:
    human = list(mouth.names.human)
    human_mm = model.markers_mm(frames)[:, human]
    rest_mm = model.markers_mm(model.rest[None])[:, human]
    copies_mm = mouth.neutral_mm() + scale * (human_mm - rest_mm)
    shape_features = mouth.names.shape_features
    wanted = shape_features.of(copies_mm, wanted_gaps_mm(human_mm, mouth.names, scale))
    shapes_mm = mouth.markers_of(mouth.nearest_deg(wanted))
    inputs = np.hstack([np.ones((len(frames), 1)), frames - model.rest])
    fit = np.asarray(np.linalg.lstsq(inputs, shapes_mm.reshape(len(frames), -1), rcond=None)[0])
    aims_mm = (inputs @ fit).reshape(shapes_mm.shape)
    lips = list(shape_features.lips)
    left_mm = np.sqrt(np.sum((shapes_mm - aims_mm)[:, lips] ** 2, axis=2).mean(axis=1))
    copy_mm = np.sum((shapes_mm - copies_mm)[:, lips] ** 2, axis=2)
    retargeting = Retargeting(fit[0].reshape(-1, 3), fit[1:], scale, float(np.sqrt(copy_mm.mean())))
    return _Aim(retargeting, float((left_mm <= _FOLLOWED_MM).mean()))


def wanted_gaps_mm(human_mm: Array, names: Correspondence, scale: Array) -> Array:
    """(n, n_gaps, 3): the speaker's at the robot's scale, less what still counts as closed."""
    gaps_mm = scale * names.shape_features.gaps_mm(human_mm)
    gaps_mm[..., 1] -= scale[1] * CLOSED_GAP_MM + PRESS_MM
    return gaps_mm


def match_ranges(human_mm: Array, mouth: RobotMouth) -> Array:
    """(3,): robot over speaker. Up: so that openings fill the robot's; across: so that widths do.

    What is forward is scaled as what is across: both are what the lips' ring does when it rounds.
    """
    names = mouth.names
    right, left = names.corners
    _check_a_mouth(mouth)
    width_mm = human_mm[:, left, 0] - human_mm[:, right, 0]
    size = _width_mm(mouth.neutral_mm(), names) / np.median(width_mm)
    upper, lower = names.shape_features.gaps[0]
    opening_mm = human_mm[:, upper, 1] - human_mm[:, lower, 1]
    most_open_mm, least_wide_mm, most_wide_mm = _robot_ranges_mm(mouth)
    up = most_open_mm / np.quantile(opening_mm, _RANGE_QUANTILE)
    human_range_mm = np.diff(np.quantile(width_mm, [1 - _RANGE_QUANTILE, _RANGE_QUANTILE]))[0]
    across = (most_wide_mm - least_wide_mm) / max(human_range_mm, 1e-6)
    most = MOST_EXAGGERATION * size
    across, up = min(_USED_SHARE * across, most), min(_USED_SHARE * up, most)
    return np.array([across, up, across])


def _check_a_mouth(mouth: RobotMouth) -> None:
    """Raises CalibrationError for points that are not those of a mouth which opens."""
    names = mouth.names.marker_names
    right, left = mouth.names.corners
    width_mm = _width_mm(mouth.neutral_mm(), mouth.names)
    if width_mm < _LEAST_WIDTH_MM:
        raise CalibrationError(
            f"the corners {names[right]} and {names[left]} are {width_mm:.1f} mm apart from right "
            "to left; are they the right points, in millimetres, x to the robot's left?"
        )
    upper, lower = mouth.names.shape_features.gaps[0]
    opening_mm = _robot_ranges_mm(mouth)[0]
    if opening_mm < _LEAST_OPENING_MM:
        raise CalibrationError(
            f"{names[upper]} and {names[lower]} part by {opening_mm:.1f} mm at most; are they the "
            "right points, and does any joint open the mouth?"
        )


def _width_mm(markers_mm: Array, names: Correspondence) -> float:
    right, left = names.corners
    return float(markers_mm[left, 0] - markers_mm[right, 0])


def _robot_ranges_mm(mouth: RobotMouth) -> tuple[float, float, float]:
    """The widest opening, the narrowest and the widest mouth, each joint at its better end.

    Joint by joint, as a hill is climbed along its axes: the faces are close to linear.
    """
    names, limits_deg, markers_of = mouth.names, mouth.limits_deg, mouth.markers_of
    right, left = names.corners
    upper, lower = names.shape_features.gaps[0]

    def best(measure: Array) -> float:
        """measure: (n_markers * 3,) signs of what should grow."""
        pose_deg = np.zeros((1, len(limits_deg[0])))
        for joint in range(len(limits_deg[0])):
            tries = np.repeat(pose_deg, 3, axis=0)
            tries[:, joint] = (limits_deg[0][joint], 0.0, limits_deg[1][joint])
            values = markers_of(tries).reshape(3, -1) @ measure
            pose_deg = tries[values.argmax()][None]
        return float(markers_of(pose_deg).reshape(-1) @ measure)

    opening = np.zeros((len(names.marker_names), 3))
    opening[upper, 1], opening[lower, 1] = 1.0, -1.0
    width = np.zeros_like(opening)
    width[left, 0], width[right, 0] = 1.0, -1.0
    return best(opening.ravel()), -best(-width.ravel()), best(width.ravel())
