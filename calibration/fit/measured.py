"""From captured poses to a calibration, with its errors: the measured way, from end to end.

Loads scikit-learn; the live path never does.
"""

from dataclasses import dataclass

import numpy as np

from calibration.calibration import (
    Calibration,
    CalibrationError,
    Following,
    Origin,
    Touch,
)
from calibration.capture.capture import Capture
from calibration.capture.sanity import check_capture
from calibration.fit.correspondence import Correspondence, RobotMouth, correspond
from calibration.fit.measured_errors import ShapeErrors, measure_shapes
from calibration.fit.retargeting import Retargeting, fit_retargeting
from calibration.fit.robot_face import RobotFace, fit_robot_face
from calibration.mouth_servos import MouthServos
from calibration.run.run_time_map import fit_run_time_map
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array

HOLD_OUT_SHARE = 0.2
#: At most so many AnimPhos of 5 frames are fitted to: a map of 45 numbers for each servo needs no
#: more. And held out: so many that closures, a tenth of the frames, are well over fifty.
MAX_FITTED, MAX_HELD_OUT = 240, 160
#: A fifth of what an XL330-M288-T draws when stalled at 5 V, 1.47 A
#: (https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/#specifications). Soft lips need less.
TOUCH_CURRENT_MA = 294.0

#: Each round takes away most of what the last one missed.
_TOUCH_ROUNDS = 4


@dataclass(frozen=True, slots=True)
class MeasuredFit:
    """A calibration and what it was made of, for reports and scores."""

    calibration: Calibration
    face: RobotFace
    retargeting: Retargeting
    names: Correspondence
    held_out: Array
    warnings: tuple[str, ...]


def fit_measured(
    model: FaceWithAnimPhos,
    capture: Capture,
    servos: MouthServos,
    *,
    date: str = "",
    seed: int = 0,
) -> MeasuredFit:
    """The whole way: sanity, face, retargeting, inverse, run-time map, errors on held-out AnimPhos.

    Raises CalibrationError for a capture that cannot be trusted.
    """
    names = correspond(capture.marker_names)
    warnings = check_capture(capture, model, servos.positive)
    face = fit_robot_face(capture)
    limits = servos.limits_deg
    fit, held_out = split_frames(model, seed)
    mouth = RobotMouth(face.markers_mm, names, limits, servos.rules)
    retargeting = fit_retargeting(model, fit, mouth)
    found = ShapeErrors(model, mouth, retargeting)
    poses_deg = found.best_deg(retargeting.targets_mm(fit - model.rest))
    run = fit_run_time_map(fit - model.rest, poses_deg, face.markers_mm, names.shape_features)
    errors, coverage = measure_shapes(found, run, held_out)
    calibration = Calibration(
        servo_names=capture.servo_names,
        weights=run.weights,
        quadratic_weights=run.quadratic_weights,
        rest=model.rest,
        rest_deg=run.rest_deg,
        x_range=run.x_range,
        min_deg=limits[0],
        max_deg=limits[1],
        errors=errors,
        model_checksum=model.checksum,
        face_checksum=servos.face_checksum,
        origin=Origin("measured", date, len(capture), servos.models),
        following=backlash_only(face.backlash_deg),
        touch=Touch(_touch_deg(mouth, retargeting), TOUCH_CURRENT_MA),
        coverage=coverage,
        rules=servos.rules,
    )
    return MeasuredFit(calibration, face, retargeting, names, held_out, warnings)


def split_frames(model: FaceWithAnimPhos, seed: int) -> tuple[Array, Array]:
    """Frames (n, n_components) to fit and to hold out, of different AnimPhos drawn by `seed`."""
    order = np.random.default_rng(seed).permutation(len(model.animphos))
    if len(order) < 2:
        raise CalibrationError("a calibration needs a model with at least 2 AnimPhos")
    n_held_out = min(MAX_HELD_OUT, max(1, round(HOLD_OUT_SHARE * len(order))))
    held_out, fit = order[:n_held_out], order[n_held_out : n_held_out + MAX_FITTED]
    frames = model.animphos.samples.reshape(len(order), -1, model.n_components)
    return np.concatenate(frames[fit]), np.concatenate(frames[held_out])


def backlash_only(backlash_deg: Array) -> Following:
    """Nothing known of lags and speeds yet: no lag, no limit."""
    unknown = np.full(len(backlash_deg), np.inf)
    return Following(np.zeros(len(backlash_deg)), backlash_deg, unknown, unknown)


def _touch_deg(mouth: RobotMouth, retargeting: Retargeting) -> Array:
    """(n_servos,): near the robot's closed mouth, with the middle of the lips just meeting.

    The closed mouth of speech is pressed, and the shape of the pressed lips pulls the gap with it;
    so the gap asked for is put off by what was missed, a few times.
    """
    shape_features = mouth.names.shape_features
    closed_mm = retargeting.neutral_mm[None]
    gaps_mm = shape_features.gaps_mm(closed_mm)
    gaps_mm[..., 1] = 0.0
    for _ in range(_TOUCH_ROUNDS):
        pose_deg = mouth.nearest_deg(shape_features.of(closed_mm, gaps_mm))
        gaps_mm[..., 1] -= shape_features.gaps_mm(mouth.markers_of(pose_deg))[:, :1, 1]
    return np.asarray(pose_deg[0])
