"""What a robot should do with speech, defined before any fit and the same for every method.

The wanted gap of the lips is the robot's own closed gap plus scale times (the speaker's gap minus
the speaker's closed gap); scale is the ratio of the widest gaps that the two reach, at most 1.3. A
literal copy is the robot's neutral plus scale times the speaker's motion, with these gaps. The
wanted shape is that of the robot's own pose nearest to the copy, found on the true robot.
"""

from dataclasses import dataclass

import numpy as np

from calibration.fit.correspondence import correspond
from calibration.mouth_servos import MouthServos
from calibration.simulated.elastic_robot import ElasticFace
from calibration.simulated.elastic_skin import N_PAIRS
from lipservo_lab.bench.calibration.nearest_poses import converged_poses_deg
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array
from lipsync.markers import MARKERS_47

MOST_SCALE = 1.3
_RANGE_QUANTILE = 0.98
NAMES = correspond(MARKERS_47.names)


@dataclass(frozen=True, slots=True)
class WantedShapes:
    """For frames of speech (n, n_components).

    features: (n, n_features), of the literal copies, as ShapeFeatures has them; shapes_mm:
    (n, 47, 3), of the nearest poses; gap_mm: (n,), the height in the middle that is wanted beyond
    the robot's own closed gap; human_gap_mm: (n,), how far the speaker's lips are apart.
    """

    scale: float
    features: Array
    shapes_mm: Array
    gap_mm: Array
    human_gap_mm: Array


def wanted_shapes(
    model: FaceWithAnimPhos, face: ElasticFace, servos: MouthServos, frames: Array
) -> WantedShapes:
    """Of the robot as it truly is, warm."""
    human_gap_mm = model.lip_gaps_mm(model.markers_mm(frames))
    speakers_mm = model.lip_gaps_mm(model.markers_mm(model.animphos.frames[::7]))
    opens_mm = float(np.quantile(speakers_mm, _RANGE_QUANTILE)) - model.lip_gap_mm(model.rest)
    scale = min(MOST_SCALE, widest_gap_mm(face, servos) / opens_mm)
    rest_mm = model.markers_mm(model.rest[None])
    moved_mm = model.markers_mm(frames) - rest_mm
    neutral_mm = face.markers_mm(np.zeros((1, len(servos.joints))))
    of = NAMES.shape_features
    gaps_mm = of.gaps_mm(neutral_mm) + scale * of.gaps_mm(moved_mm)
    off_mm = face.draw.skin.off_edge_mm
    own_closed_mm = (off_mm[:3] + off_mm[3:])[[1, 0, 2]]  # middle, right, left
    opened_mm = np.maximum(scale * of.gaps_mm(moved_mm)[..., 1], 0.0)
    gaps_mm[..., 1] = own_closed_mm + opened_mm
    features = of.of(neutral_mm + scale * moved_mm, gaps_mm)
    nearest_deg = converged_poses_deg(face.markers_mm, features, of, servos.limits_deg)
    return WantedShapes(
        scale=scale,
        features=features,
        shapes_mm=face.markers_mm(nearest_deg),
        gap_mm=opened_mm[:, 0],
        human_gap_mm=human_gap_mm,
    )


def widest_gap_mm(face: ElasticFace, servos: MouthServos) -> float:
    """Of the lips' own edges, each joint in turn at its better end, twice round."""
    limits_deg, middle = servos.limits_deg, N_PAIRS // 2
    pose_deg = np.zeros((1, len(servos.joints)))
    for joint in (*range(len(servos.joints)), *range(len(servos.joints))):
        tries = np.repeat(pose_deg, 3, axis=0)
        tries[:, joint] = (limits_deg[0][joint], 0.0, limits_deg[1][joint])
        pose_deg = tries[face.state(tries).gaps_mm[:, middle].argmax()][None]
    return float(face.state(pose_deg).gaps_mm[0, middle])
