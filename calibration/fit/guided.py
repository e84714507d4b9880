"""Calibration without a tracker: a person puts the mouth into a dozen named poses.

Each pose is a shape that the speaker of the model really made; the person moves the servos until
the robot looks like it. A line through a dozen points: usable, and coarser than a measured map.
Loads scikit-learn; the live path never does.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from sklearn.linear_model import RidgeCV

from calibration.calibration import (
    Calibration,
    CalibrationError,
    Origin,
    linear_calibration_parts,
)
from calibration.hold_out import HoldOutErrors
from calibration.mouth_servos import MouthServos
from calibration.run.run_time_map import rounded
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array
from lipsync.markers import MARKERS_47

#: From a weak to a strong pull towards not moving; leave-one-out chooses among a dozen poses.
_STRENGTHS = np.logspace(-1, 4, 16)
#: Landmark poses are near the speaker's extremes, not at them, which are odd frames.
_QUANTILE = 0.97
CLOSED = "closed"


@dataclass(frozen=True, slots=True)
class LandmarkPose:
    """One pose to make: its name, what to do, and the speaker's frame (n_components,)."""

    name: str
    instruction: str
    coefficients: Array


def _at(landmark: int) -> int:
    return MARKERS_47.landmarks.index(landmark)


def _opening(mm: Array) -> Array:
    return np.asarray(mm[:, _at(13), 1] - mm[:, _at(14), 1])


def _width(mm: Array) -> Array:
    return np.asarray(mm[:, _at(291), 0] - mm[:, _at(61), 0])


def _upper(mm: Array) -> Array:
    return np.asarray(mm[:, _at(0), 1])


def _lower(mm: Array) -> Array:
    return np.asarray(-mm[:, _at(17), 1])


def _forward(mm: Array) -> Array:
    return np.asarray((mm[:, _at(0), 2] + mm[:, _at(17), 2]) / 2)


def _corners(mm: Array) -> Array:
    return np.asarray((mm[:, _at(61), 1] + mm[:, _at(291), 1]) / 2)


#: Name, what the person is told, what is large there (each standardised, then added up).
_POSES: tuple[tuple[str, str, tuple[tuple[Callable[[Array], Array], float], ...]], ...] = (
    ("open", "open the mouth as for AH", ((_opening, 1.0),)),
    ("wide", "draw the corners apart as for EE", ((_width, 1.0),)),
    ("narrow", "draw the corners together as for OO", ((_width, -1.0),)),
    ("upper lip up", "raise the upper lip, teeth showing", ((_upper, 1.0),)),
    ("upper lip down", "lower the upper lip", ((_upper, -1.0),)),
    ("lower lip down", "lower the lower lip, teeth showing", ((_lower, 1.0),)),
    ("forward", "push the lips forward", ((_forward, 1.0),)),
    ("back", "draw the lips back against the teeth", ((_forward, -1.0),)),
    ("corners up", "raise the corners", ((_corners, 1.0),)),
    ("corners down", "lower the corners", ((_corners, -1.0),)),
    ("open and narrow", "a round open mouth as for AW", ((_opening, 1.0), (_width, -1.0))),
    ("open and wide", "open and wide as for A in cat", ((_opening, 1.0), (_width, 1.0))),
    ("closed and narrow", "nearly closed and round", ((_opening, -1.0), (_width, -1.0))),
)


def landmark_poses(model: FaceWithAnimPhos) -> tuple[LandmarkPose, ...]:
    """The closed mouth, then the poses above, each a frame of the speaker's."""
    frames = model.animphos.frames
    markers_mm = model.markers_mm(frames)
    poses = [LandmarkPose(CLOSED, "close the mouth, lips just touching", model.rest)]
    for name, instruction, parts in _POSES:
        score = np.zeros(len(frames))
        for measure, sign in parts:
            values = measure(markers_mm)
            score += sign * (values - values.mean()) / (values.std() + 1e-12)
        wanted = np.quantile(score, _QUANTILE)
        poses.append(LandmarkPose(name, instruction, frames[np.abs(score - wanted).argmin()]))
    return tuple(poses)


def fit_guided(
    model: FaceWithAnimPhos,
    servos: MouthServos,
    made_deg: Mapping[str, Array],
    *,
    date: str = "",
) -> Calibration:
    """made_deg: for each landmark pose that the person made, the angles (n_servos,).

    Exact at the closed mouth; elsewhere ridge regression. `joint_rms_deg` of its errors is what
    each pose looks like to the map made without it; millimetres are unknown without a tracker, and
    are given as 0 frames. Raises CalibrationError without the closed mouth or with too few poses.
    """
    poses = [pose for pose in landmark_poses(model) if pose.name in made_deg]
    if CLOSED not in made_deg:
        raise CalibrationError(f"the pose {CLOSED!r} is missing; everything is measured from it")
    if len(poses) < model.n_components + 2:
        raise CalibrationError(
            f"{len(poses)} poses are too few, {model.n_components + 2} are needed; "
            "run `lipservo calibrate guided` again and make more of them"
        )
    closed_deg = made_deg[CLOSED]
    x = np.array([pose.coefficients - model.rest for pose in poses if pose.name != CLOSED])
    turned_deg = np.array([made_deg[p.name] - closed_deg for p in poses if p.name != CLOSED])
    weights, left_out_deg = _ridge(x, turned_deg)
    quadratic_weights, _, x_range = linear_calibration_parts(len(servos.joints), model.n_components)
    return Calibration(
        servo_names=servos.names,
        weights=weights,
        quadratic_weights=quadratic_weights,
        rest=model.rest,
        rest_deg=rounded(closed_deg),
        x_range=x_range,
        min_deg=servos.limits_deg[0],
        max_deg=servos.limits_deg[1],
        errors=_unmeasured(left_out_deg),
        model_checksum=model.checksum,
        face_checksum=servos.face_checksum,
        origin=Origin("guided", date, len(poses), servos.models),
    )


def _ridge(x: Array, turned_deg: Array) -> tuple[Array, Array]:
    """Weights (n_servos, n_components) and, for each servo, the leave-one-out error in degrees."""
    ridge = RidgeCV(_STRENGTHS, fit_intercept=False).fit(x, turned_deg)
    weights = rounded(np.asarray(ridge.coef_, dtype=np.float64).reshape(turned_deg.shape[1], -1))
    normal = x.T @ x + ridge.alpha_ * np.eye(x.shape[1])
    leverage = np.einsum("ni,ni->n", x, np.linalg.solve(normal, x.T).T)
    left_out = (turned_deg - x @ weights.T) / (1.0 - leverage)[:, None]
    return weights, np.asarray(np.sqrt(np.mean(left_out**2, axis=0)))


def _unmeasured(joint_rms_deg: Array) -> HoldOutErrors:
    return HoldOutErrors(
        n_frames=0,
        marker_rms_mm=0.0,
        lip_rms_mm=0.0,
        nearest_lip_rms_mm=0.0,
        gap_rms_mm=0.0,
        gap_correlation=0.0,
        n_closures=0,
        closed_gap_mm=0.0,
        clipped_share=0.0,
        joint_rms_deg=tuple(float(v) for v in joint_rms_deg),
    )
