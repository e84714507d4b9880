"""From captured poses to a calibration, with its errors: the measured way, from end to end.

Loads scikit-learn; the live path never does.
"""

from dataclasses import dataclass

import numpy as np
from threadpoolctl import threadpool_limits

from calibration.calibration import (
    Calibration,
    CalibrationError,
    Following,
    Origin,
    Touch,
)
from calibration.capture.capture import Capture
from calibration.capture.sanity import check_capture
from calibration.fit.best_map import choose_map
from calibration.fit.correspondence import Correspondence, RobotMouth, correspond
from calibration.fit.lip_contact import gap_heights_mm
from calibration.fit.loose_joint import loose_joint
from calibration.fit.measured_errors import ShapeErrors, measure_shapes
from calibration.fit.retargeting import (
    LEAST_OPENING_MM,
    PRESS_MM,
    Retargeting,
    fit_retargeting,
    no_opening,
)
from calibration.fit.robot_face import RobotFace, fit_robot_face
from calibration.grade import LearntLips
from calibration.mouth_servos import MouthServos
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array

HOLD_OUT_SHARE = 0.2
#: At most so many AnimPhos of 5 frames are fitted to: a map of 45 numbers for each servo needs no
#: more. And held out: so many that closures, a tenth of the frames, are well over fifty.
MAX_FITTED, MAX_HELD_OUT = 240, 160
#: A fifth of what an XL330-M288-T draws when stalled at 5 V, 1.47 A
#: (https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/#specifications). Soft lips need less.
TOUCH_CURRENT_MA = 294.0

#: Where lips were seen to stop each other, closures go so far past contact: a few times what the
#: learnt gap of closed lips is wrong by.
_CONTACT_PRESS_MM = 0.4
#: One narrow reading may be noise.
_NARROWEST = 0.05


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
    accept: bool = False,
) -> MeasuredFit:
    """The whole way: sanity, face, retargeting, inverse, run-time map, errors on held-out AnimPhos.

    accept: what is judgement only warns. Raises CalibrationError for a capture that cannot be
    trusted.
    """
    # Threads that share small products wait for each other: a minute in place of twenty seconds.
    with threadpool_limits(limits=1):
        return _fit(model, capture, servos, date, seed, accept)


def _fit(
    model: FaceWithAnimPhos,
    capture: Capture,
    servos: MouthServos,
    date: str,
    seed: int,
    accept: bool,
) -> MeasuredFit:
    names = correspond(capture.marker_names)
    checked = check_capture(capture, model, servos.positive, accept=accept)
    capture = checked.capture
    face = fit_robot_face(capture, names.shape_features)
    warnings = (*checked.warnings, *loose_joint(face.servo_names, face.backlash_deg))
    limits = servos.limits_deg
    fit, held_out = split_frames(model, seed)
    mouth = mouth_of(face, names, servos)
    chosen = choose_map(retargeting_of(model, mouth, face, capture), fit - model.rest)
    retargeting, run = chosen.retargeting, chosen.run
    errors, coverage = measure_shapes(ShapeErrors(model, mouth, retargeting), run, held_out)
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
        touch=Touch(_touch_deg(retargeting), TOUCH_CURRENT_MA),
        coverage=coverage,
        rules=servos.rules,
        centres=run.centres,
        centre_weights=run.centre_weights,
        learnt_lips=LearntLips(
            left_out_rms_mm=face.left_out_rms_mm,
            noise_mm=face.noise_mm,
            own_gap_mm=float(retargeting.closed_mm[0]),
            stop=face.contact is not None,
        ),
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


def mouth_of(face: RobotFace, names: Correspondence, servos: MouthServos) -> RobotMouth:
    """The learnt face as retargeting sees it."""
    return RobotMouth(face.free_mm, names, servos.limits_deg, servos.rules, face.markers_mm)


def retargeting_of(
    model: FaceWithAnimPhos, mouth: RobotMouth, face: RobotFace, capture: Capture
) -> Retargeting:
    """What is asked of a learnt face: by where its lips stop, where they were seen to.

    Its scale is by all that the speaker said: a fiftieth of a few hundred frames is chance.
    """
    frames = model.animphos.frames
    heights_mm = gap_heights_mm(capture.markers_mm, mouth.names.shape_features.gaps)
    parts_mm = float(np.ptp(np.nanquantile(heights_mm[:, 0], [_NARROWEST, 1.0 - _NARROWEST])))
    if parts_mm < LEAST_OPENING_MM:
        raise no_opening(mouth, parts_mm)
    if face.contact is not None:
        return fit_retargeting(model, frames, mouth, face.contact.closed_mm, _CONTACT_PRESS_MM)
    # Dots cannot pass each other, so lips touch at 0 at the latest; dots that never came so near
    # lie beside the edges, and the narrowest that was seen is the best guess.
    narrowest_mm = np.nanquantile(heights_mm, _NARROWEST, axis=0)
    return fit_retargeting(model, frames, mouth, np.maximum(narrowest_mm, 0.0), PRESS_MM)


def _touch_deg(retargeting: Retargeting) -> Array:
    """(n_servos,): the speaker's rest with the middle of the lips just meeting."""
    rest = np.zeros((1, retargeting.model.n_components))
    return np.asarray(retargeting.at_gap(rest, float(retargeting.closed_mm[0]))[0])
