"""What poses look like on a true elastic robot, against the shapes that were wanted.

The pose of a true robot that is nearest to a shape, to convergence.

Lips that stop each other make a robot's shape bend sharply at contact, where plain Gauss-Newton
goes to and fro; here each step is damped until it helps (Levenberg-Marquardt: More, The
Levenberg-Marquardt algorithm, 1978), and shortened by the joints' limits.

What a robot should do with speech, defined before any fit and the same for every method.

The wanted gap of the lips is the robot's own closed gap plus scale times (the speaker's gap minus
the speaker's closed gap); scale is the ratio of the widest gaps that the two reach, at most 1.3. A
literal copy is the robot's neutral plus scale times the speaker's motion, with these gaps. The
wanted shape is that of the robot's own pose nearest to the copy, found on the true robot.

The textbook's way from the same capture: ridge from angles to markers, bounded least squares.

It is given the wanted shapes as they are defined, the robot's own closed gap and scale included,
which a calibration has to find out.
"""

from dataclasses import dataclass

import numpy as np
from sklearn.linear_model import RidgeCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures, StandardScaler

from calibration.calibration import Calibration
from calibration.capture.capture import Capture
from calibration.closure import CLOSED_GAP_MM
from calibration.fit.retargeting import (
    NEUTRAL_WEIGHT_MM_PER_DEG,
    MarkersOf,
    RobotMouth,
    ShapeFeatures,
    bounded_minimum,
    correspond,
    shape_slopes,
)
from calibration.mouth_servos import MouthServos
from calibration.run.compensation import BacklashCompensation
from calibration.simulated.elastic_robot import N_PAIRS, ElasticFace
from calibration.simulated.robot import SimulatedRobot
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array
from lipsync.markers import MARKERS_47

#: Robots of seeds 103, 105 and 106: three beginnings end within 0.06 mm of one another.
_ROUNDS = 30
_FIRST_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1.0, 1e-3, 1e6
_EASED, _HARDENED = 1.0 / 3.0, 4.0


@dataclass(frozen=True, slots=True)
class _Tried:
    """Poses (n, n_servos), the features that they show (n, n_features), and their costs (n,)."""

    poses_deg: Array
    shown: Array
    cost: Array

    def better_of(self, other: "_Tried") -> "_Tried":
        """Return, for each frame, the poses with the lower cost of the two."""
        ours = (self.cost <= other.cost)[:, None]
        return _Tried(
            np.where(ours, self.poses_deg, other.poses_deg),
            np.where(ours, self.shown, other.shown),
            np.minimum(self.cost, other.cost),
        )


def converged_poses_deg(
    markers_of: MarkersOf,
    wanted: Array,
    shape_features: ShapeFeatures,
    limits_deg: tuple[Array, Array],
) -> Array:
    """Return the poses nearest to wanted shapes, found by damped Gauss-Newton steps from neutral.

    The cost is that of `RobotMouth.nearest_deg`.

    Parameters
    ----------
    markers_of : MarkersOf
        Gives markers (n, n_markers, 3) mm of poses (n, n_servos) degrees.
    wanted : Array
        (n, n_features).
    shape_features : ShapeFeatures
        Computes the features of a shape from its markers.
    limits_deg : tuple[Array, Array]
        Least and greatest angles, (n_servos,) each.

    Returns
    -------
    Array
        (n, n_servos) degrees.
    """

    def evaluate(poses_deg: Array) -> _Tried:
        shown = shape_features.of(markers_of(poses_deg))
        shape_cost = np.sum((shown - wanted) ** 2, axis=1)
        turn_cost = NEUTRAL_WEIGHT_MM_PER_DEG**2 * np.sum(poses_deg**2, axis=1)
        return _Tried(poses_deg, shown, shape_cost + turn_cost)

    n_servos = len(limits_deg[0])
    best = evaluate(np.zeros((len(wanted), n_servos)))
    damping = np.full(len(wanted), _FIRST_DAMPING)
    for _ in range(_ROUNDS):
        # One damped Gauss-Newton step for all frames: curvature and gradient of the cost, the
        # minimum within the limits; it is kept where it lowers the cost.
        slopes = shape_slopes(markers_of, shape_features, best.poses_deg, best.shown)
        transposed = slopes.transpose(0, 2, 1)
        curvature = transposed @ slopes
        curvature += (NEUTRAL_WEIGHT_MM_PER_DEG**2 + damping[:, None, None]) * np.eye(n_servos)
        pull = (transposed @ (wanted - best.shown)[..., None])[..., 0]
        pull -= NEUTRAL_WEIGHT_MM_PER_DEG**2 * best.poses_deg
        pull += (curvature @ best.poses_deg[..., None])[..., 0]
        candidate = evaluate(bounded_minimum(curvature, pull, *limits_deg))
        is_better = candidate.cost < best.cost
        best = best.better_of(candidate)
        damping *= np.where(is_better, _EASED, _HARDENED)
        damping = np.clip(damping, _LEAST_DAMPING, _MOST_DAMPING)
    return best.poses_deg


MOST_SCALE = 1.3
_RANGE_QUANTILE = 0.98
NAMES = correspond(MARKERS_47.names)


@dataclass(frozen=True, slots=True)
class WantedShapes:
    """The shapes that a robot should show for n frames of speech.

    scale: robot's over speaker's mouth. features: (n, n_features), of literal copies of the frames;
    shapes_mm: (n, 47, 3), markers of the robot's poses nearest to these; gap_mm: (n,), the wanted
    opening between the lips' middles beyond the robot's closed gap; human_gap_mm: (n,), the
    speaker's lip gap.
    """

    scale: float
    features: Array
    shapes_mm: Array
    gap_mm: Array
    human_gap_mm: Array


def wanted_shapes(
    model: FaceWithAnimPhos, face: ElasticFace, servos: MouthServos, frames: Array
) -> WantedShapes:
    """Return the shapes that the robot should show, as the module's docstring defines them.

    Parameters
    ----------
    model : FaceWithAnimPhos
        The speaker's face.
    face : ElasticFace
        The robot.
    servos : MouthServos
        The robot's joints and limits.
    frames : Array
        (n, n_components), coefficients of the speaker's face.

    Returns
    -------
    WantedShapes
        Shapes in mm.
    """
    human_gap_mm = model.lip_gaps_mm(model.markers_mm(frames))
    gaps_of_all_mm = model.lip_gaps_mm(model.markers_mm(model.animphos.frames[::7]))
    opens_mm = float(np.quantile(gaps_of_all_mm, _RANGE_QUANTILE)) - model.lip_gap_mm(model.rest)
    scale = min(MOST_SCALE, widest_gap_mm(face, servos) / opens_mm)
    rest_mm = model.markers_mm(model.rest[None])
    moved_mm = model.markers_mm(frames) - rest_mm
    neutral_mm = face.markers_mm(np.zeros((1, len(servos.joints))))
    shape_features = NAMES.shape_features
    gaps_mm = shape_features.gaps_mm(neutral_mm) + scale * shape_features.gaps_mm(moved_mm)
    edge_mm = face.draw.skin.off_edge_mm
    # The markers' gaps while the lips' edges touch: upper and lower marker's distance from the
    # edge; order: middle, right, left.
    own_closed_mm = (edge_mm[:3] + edge_mm[3:])[[1, 0, 2]]  # middle, right, left
    opened_mm = np.maximum(scale * shape_features.gaps_mm(moved_mm)[..., 1], 0.0)
    gaps_mm[..., 1] = own_closed_mm + opened_mm
    features = shape_features.of(neutral_mm + scale * moved_mm, gaps_mm)
    nearest_deg = converged_poses_deg(face.markers_mm, features, shape_features, servos.limits_deg)
    return WantedShapes(
        scale=scale,
        features=features,
        shapes_mm=face.markers_mm(nearest_deg),
        gap_mm=opened_mm[:, 0],
        human_gap_mm=human_gap_mm,
    )


def widest_gap_mm(face: ElasticFace, servos: MouthServos) -> float:
    """Return the widest gap between the middles of the lips that the robot reaches, mm.

    Searched by moving each joint in turn to its best of least, 0 and greatest angle, all of them
    twice.
    """
    limits_deg, middle = servos.limits_deg, N_PAIRS // 2
    pose_deg = np.zeros((1, len(servos.joints)))
    for joint in (*range(len(servos.joints)), *range(len(servos.joints))):
        candidates_deg = np.repeat(pose_deg, 3, axis=0)
        candidates_deg[:, joint] = (limits_deg[0][joint], 0.0, limits_deg[1][joint])
        pose_deg = candidates_deg[face.state(candidates_deg).gaps_mm[:, middle].argmax()][None]
    return float(face.state(pose_deg).gaps_mm[0, middle])


#: Lips whose edges are this near touch.
_TOUCH_MM = 0.02
#: The force that suffices closes a slit that is so much too wide all along.
_ENOUGH_MM = 0.15


@dataclass(frozen=True, slots=True)
class Motion:
    """The scores of a robot's motion against the wanted shapes.

    off_mm: lip error, rms over frames and lip markers. gap_r, gap_slope: correlation of the lip gap
    with the wanted one, and slope over it. touch: share of closures in which lips touch, 0 to 1.
    force_ratio: median force between closed lips over the force that suffices.
    """

    off_mm: float
    gap_r: float
    gap_slope: float
    touch: float
    force_ratio: float


def played(face: ElasticFace, calibration: Calibration, frames: Array) -> Array:
    """Return the angles of the servo horns for frames sent one by one, with backlash compensated.

    Parameters
    ----------
    face : ElasticFace
        The robot.
    calibration : Calibration
        Maps frames to the robot's joints; its backlash is compensated.
    frames : Array
        (n, n_components), coefficients of the speaker's face.

    Returns
    -------
    Array
        (n, n_servos) degrees.
    """
    following = calibration.following
    n_servos = len(calibration.servo_names)
    backlash = BacklashCompensation(
        np.zeros(n_servos) if following is None else following.backlash_deg
    )
    goals = [backlash.feed(pose_deg[None])[0] for pose_deg in calibration.poses_deg(frames)]
    return behind_play(face, np.array(goals))


def behind_play(face: ElasticFace, goals_deg: Array) -> Array:
    """Return the angles of the servo horns, behind their backlash, for goals sent one by one.

    Parameters
    ----------
    face : ElasticFace
        The robot.
    goals_deg : Array
        (n, n_servos).

    Returns
    -------
    Array
        (n, n_servos) degrees, after each goal.
    """
    robot = SimulatedRobot(face)
    horns_deg = []
    for goal_deg in goals_deg:
        robot.move(goal_deg)
        horns_deg.append(robot.output_deg)
    return np.array(horns_deg)


def shown(face: ElasticFace, output_deg: Array, wanted: WantedShapes) -> Motion:
    """Return lip error, gap correlation and slope, closures and closing force of a motion.

    Parameters
    ----------
    face : ElasticFace
        The robot.
    output_deg : Array
        (n, n_servos), angles of the servo horns for the wanted frames.
    wanted : WantedShapes
        The shapes of these n frames.

    Returns
    -------
    Motion
        Scores; distances in mm.
    """
    state = face.state(output_deg)
    off_mm = (state.markers_mm - wanted.shapes_mm)[:, list(MARKERS_47.lips)]
    gap_mm = state.gaps_mm[:, N_PAIRS // 2]
    touches = gap_mm <= _TOUCH_MM
    closed = wanted.human_gap_mm <= CLOSED_GAP_MM
    is_moving = gap_mm.std() > 0.0
    return Motion(
        off_mm=float(np.sqrt(np.mean(np.sum(off_mm**2, axis=2)))),
        gap_r=float(np.corrcoef(wanted.gap_mm, gap_mm)[0, 1]) if is_moving else 0.0,
        gap_slope=float(np.polyfit(wanted.gap_mm, gap_mm, 1)[0]),
        touch=float(touches[closed].mean()),
        force_ratio=float(np.median(state.force_n[closed]) / face.closing_force_n(_ENOUGH_MM)),
    )


def rest_force_ratio(face: ElasticFace, calibration: Calibration) -> float:
    """Return the force between the lips of a face at rest, over the force that suffices."""
    rest_frames = np.repeat(calibration.rest[None], 10, axis=0)  # until it stands still
    state = face.state(played(face, calibration, rest_frames)[-1:])
    return float(state.force_n[0] / face.closing_force_n(_ENOUGH_MM))


_STRENGTHS = np.logspace(-3, 3, 13)


def rival_poses_deg(capture: Capture, servos: MouthServos, features: Array, degree: int) -> Array:
    """Return the poses by the textbook's way: a ridge from angles to markers, then least squares.

    Parameters
    ----------
    capture : Capture
        Poses and markers that the ridge is fitted to; missing markers count as in the middle.
    servos : MouthServos
        The robot's joints and limits.
    features : Array
        (n, n_features), of the wanted shapes.
    degree : int
        Of the polynomial of the angles: 1 or 2.

    Returns
    -------
    Array
        (n, n_servos) degrees.
    """
    ridge = make_pipeline(
        PolynomialFeatures(degree, include_bias=False), StandardScaler(), RidgeCV(_STRENGTHS)
    )
    median_mm = np.nanmedian(capture.markers_mm, axis=0)
    seen_mm = np.where(np.isfinite(capture.markers_mm), capture.markers_mm, median_mm)
    fitted_model = ridge.fit(capture.goals_deg, seen_mm.reshape(len(capture), -1))

    def markers_of(angles_deg: Array) -> Array:
        return np.asarray(fitted_model.predict(angles_deg)).reshape(len(angles_deg), -1, 3)

    return RobotMouth(markers_of, NAMES, servos.limits_deg).nearest_deg(features)
