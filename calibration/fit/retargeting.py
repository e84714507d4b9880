"""From the speaker's mouth to this robot's: what to ask for, and the pose that comes nearest.

Markers correspond by name. The wanted gap of the lips is the robot's own closed gap plus scale
times (the speaker's gap less the speaker's closed gap); scale is the ratio of the widest gaps that
the two reach, at most 1.3. The rest of the mouth is the speaker's motion at that scale, laid on the
robot's neutral. A skin drawn by a few horns cannot copy a speaker's point by point, so the shape to
aim for is that of the robot's own nearest pose; lip gaps weigh most.

Only where the speaker closes are lips asked to go past contact, by as much as the learnt gap may be
wrong there: more is force, not closure.
"""

from dataclasses import dataclass, replace

import numpy as np

from calibration.calibration import CalibrationError
from calibration.fit.correspondence import RobotMouth
from calibration.fit.lip_contact import gap_heights_mm
from calibration.hold_out import CLOSED_GAP_MM
from lipsync.arrays import Array
from lipsync.face.model import FaceModel

#: Where nobody saw lips stop each other they are asked to go so far past the closed gap.
PRESS_MM = 1.2
#: Speaker's gaps up to so much more than closed are blended from pressed to open, so that angles
#: do not jump.
_BLEND_MM = 0.8
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
    """What is asked of a mouth. closed_mm: (n_gaps,), heights between dots of lips that touch.

    scale: robot over speaker; press_mm: how far past contact where the speaker closes.
    """

    model: FaceModel
    mouth: RobotMouth
    scale: float
    closed_mm: Array
    press_mm: float

    def wanted(self, from_rest: Array) -> Array:
        """(n, n_components) -> (n, n_features): literal copies with the wanted gaps."""
        copies_mm, gaps_mm = self.copies_mm(from_rest)
        return self.mouth.names.shape_features.of(copies_mm, gaps_mm)

    def poses_deg(self, from_rest: Array) -> Array:
        """(n, n_components) -> (n, n_servos): nearest, and closed where the speaker closes."""
        copies_mm, gaps_mm = self.copies_mm(from_rest)
        of = self.mouth.names.shape_features
        poses_deg = self.mouth.nearest_deg(of.of(copies_mm, gaps_mm))
        closes = self.closing(from_rest) >= 1.0
        if closes.any():
            asked_mm = gaps_mm[closes].copy()
            for _ in range(_CLOSING_ROUNDS):
                reached_mm = gap_heights_mm(self.mouth.markers_of(poses_deg[closes]), of.gaps)
                asked_mm[..., 1] += gaps_mm[closes][..., 1] - reached_mm
                poses_deg[closes] = self.mouth.nearest_deg(of.of(copies_mm[closes], asked_mm))
        return poses_deg

    def targets_mm(self, from_rest: Array) -> Array:
        """(n, n_components) -> (n, n_markers, 3): the robot's own shapes there."""
        return self.mouth.seen_mm(self.poses_deg(from_rest))

    def at_gap(self, from_rest: Array, gap_mm: float) -> Array:
        """(1, n_components) -> (1, n_servos): the shape, its lips so high apart in the middle."""
        shifted = replace(self, closed_mm=self.closed_mm - self.closed_mm[0] + gap_mm, press_mm=0.0)
        return shifted.poses_deg(from_rest)

    def closing(self, from_rest: Array) -> Array:
        """(n,): 1 where the speaker's lips are closed, 0 where they are open."""
        gaps_mm = self.model.lip_gaps_mm(self.model.markers_mm(from_rest + self.model.rest))
        return np.asarray(np.clip(1.0 - (gaps_mm - CLOSED_GAP_MM) / _BLEND_MM, 0.0, 1.0))

    def asked_open_mm(self, from_rest: Array) -> Array:
        """(n, n_components) -> (n, n_gaps): the openings wanted beyond the robot's closed gap."""
        return np.maximum(self.copies_mm(from_rest)[1][..., 1] - self.closed_mm, 0.0)

    def off_copy_mm(self, from_rest: Array) -> float:
        """How far the shapes aimed for are from literal copies, rms over frames and lips."""
        off_mm = self.targets_mm(from_rest) - self.copies_mm(from_rest)[0]
        lips = list(self.mouth.names.shape_features.lips)
        return float(np.sqrt(np.mean(np.sum(off_mm[:, lips] ** 2, axis=2))))

    def copies_mm(self, from_rest: Array) -> tuple[Array, Array]:
        """(n, n_components) -> literal copies (n, n_markers, 3), and gaps (n, n_gaps, 3)."""
        names = self.mouth.names
        rest_mm = self.model.markers_mm(self.model.rest[None])
        moved_mm = self.model.markers_mm(from_rest + self.model.rest) - rest_mm
        moved_mm = self.scale * moved_mm[:, list(names.human)]
        neutral_mm = self.mouth.neutral_mm()[None]
        of = names.shape_features
        gaps_mm = of.gaps_mm(neutral_mm) + of.gaps_mm(moved_mm)
        closes = self.closing(from_rest)[:, None]
        opened_mm = np.maximum(of.gaps_mm(moved_mm)[..., 1], 0.0)
        gaps_mm[..., 1] = self.closed_mm + (1.0 - closes) * opened_mm - closes * self.press_mm
        return neutral_mm + moved_mm, gaps_mm


def fit_retargeting(
    model: FaceModel, frames: Array, mouth: RobotMouth, closed_mm: Array, press_mm: float = PRESS_MM
) -> Retargeting:
    """frames: (n, n_components), speech to serve; closed_mm: (n_gaps,), as in `Retargeting`.

    Raises CalibrationError for points that are not those of a mouth which opens.
    """
    widest_mm = _check_a_mouth(mouth, closed_mm)
    speakers_mm = np.quantile(model.lip_gaps_mm(model.markers_mm(frames)), _RANGE_QUANTILE)
    speakers_mm -= model.lip_gap_mm(model.rest)
    scale = min(MOST_EXAGGERATION, widest_mm / max(float(speakers_mm), 1e-6))
    return Retargeting(model, mouth, scale, closed_mm, press_mm)


def _check_a_mouth(mouth: RobotMouth, closed_mm: Array) -> float:
    """How far the lips part at most; raises CalibrationError for what is no mouth."""
    names = mouth.names.marker_names
    right, left = mouth.names.corners
    neutral_mm = mouth.neutral_mm()
    width_mm = float(neutral_mm[left, 0] - neutral_mm[right, 0])
    if width_mm < _LEAST_WIDTH_MM:
        raise CalibrationError(
            f"the corners {names[right]} and {names[left]} are {width_mm:.1f} mm apart from right "
            "to left; are they the right points, in millimetres, x to the robot's left?"
        )
    widest_mm = mouth.markers_of(widest_pose_deg(mouth)[None])
    opening_mm = float(_middle_heights_mm(mouth, widest_mm)[0] - closed_mm[0])
    if opening_mm < LEAST_OPENING_MM:
        raise no_opening(mouth, opening_mm)
    return opening_mm


def no_opening(mouth: RobotMouth, opening_mm: float) -> CalibrationError:
    """Lips that hardly part."""
    names = mouth.names.marker_names
    upper, lower = mouth.names.shape_features.gaps[0]
    return CalibrationError(
        f"{names[upper]} and {names[lower]} part by {opening_mm:.1f} mm at most; are they the "
        "right points, and does any joint open the mouth?"
    )


def widest_pose_deg(mouth: RobotMouth) -> Array:
    """(n_servos,): middle gap as high as it goes, each joint in turn at its better end, twice."""
    limits_deg = mouth.limits_deg
    n_servos = len(limits_deg[0])
    pose_deg = np.zeros((1, n_servos))
    for joint in (*range(n_servos), *range(n_servos)):
        tries = np.repeat(pose_deg, 3, axis=0)
        tries[:, joint] = (limits_deg[0][joint], 0.0, limits_deg[1][joint])
        heights_mm = _middle_heights_mm(mouth, mouth.markers_of(mouth.kept_deg(tries)))
        pose_deg = tries[heights_mm.argmax()][None]
    return np.asarray(mouth.kept_deg(pose_deg)[0])


def _middle_heights_mm(mouth: RobotMouth, markers_mm: Array) -> Array:
    """(n, n_markers, 3) -> (n,)."""
    return gap_heights_mm(markers_mm, mouth.names.shape_features.gaps[:1])[:, 0]
