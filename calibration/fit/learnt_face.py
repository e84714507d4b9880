"""Fit of a calibration to the simulated face. Loads scikit-learn; the live path never does."""

from collections.abc import Sequence
from functools import partial

import numpy as np
from sklearn.linear_model import RidgeCV

from calibration.calibration import Calibration, CalibrationError, CouplingRule
from calibration.fit.measured import split_frames
from calibration.fit.retargeting import RobotMouth, correspond
from calibration.fit.run_time_map import rounded
from calibration.grade import HoldOutErrors, measure_hold_out
from calibration.mouth_servos import JointRange, MouthServos, linear_calibration
from calibration.simulated.face import marker_positions_mm, simulated_face
from lipsync.animpho.units import FaceWithAnimPhos
from lipsync.arrays import Array
from lipsync.markers import MARKERS_47

#: Half or twice as many changed the lip error on grid_s1 by less than 0.02 mm; 3 s to fit.
MAX_ANIMPHOS = 1000
#: From next to none (coefficients are millimetres, a fit has thousands of frames) to heavy.
_RIDGE_STRENGTHS = np.logspace(-2, 6, 17)


def fit_calibration(
    model: FaceWithAnimPhos,
    joints: Sequence[JointRange],
    face_checksum: str,
    *,
    rules: Sequence[CouplingRule] = (),
    seed: int = 0,
    max_animphos: int = MAX_ANIMPHOS,
) -> Calibration:
    """Return a calibration of the simulated face: ridge regression to the best imitating angles.

    face_checksum: of the face's YAML file, stored in the calibration. A fifth of up to
    `max_animphos` AnimPhos (recorded mouth motions about a phoneme), drawn by `seed`, are held out
    for the errors. No intercept: the rest of the model is 0 degrees exactly. One ridge strength
    serves all servos, so that what two servos do together, such as the lip gap, is regressed as
    well as either. Raises CalibrationError for a servo unknown to the simulated face, or fewer than
    2 AnimPhos.
    """
    servos = MouthServos(tuple(joints), face_checksum, rules=tuple(rules))
    fitted, held_out = split_frames(model, seed, max_animphos)
    try:
        face = simulated_face(model.markers_mm(model.rest[None])[0], servos.names)
    except ValueError as error:
        raise CalibrationError(str(error)) from error
    names = correspond(MARKERS_47.names)
    markers_of = partial(marker_positions_mm, face)
    mouth = RobotMouth(markers_of, names, servos.limits_deg, servos.rules)
    nearest_deg = mouth.nearest_deg(names.shape_features.of(model.markers_mm(fitted)))
    weights = ridge_weights(fitted - model.rest, nearest_deg)
    errors = _errors(model, mouth, weights, held_out)
    return linear_calibration(model, servos, weights, errors=errors, rules=servos.rules)


def ridge_weights(from_rest: Array, positions_deg: Array) -> Array:
    """Return ridge regression weights, rounded to the digits of the calibration file.

    The strength is chosen by leave-one-out errors within these frames.

    Parameters
    ----------
    from_rest : Array
        (n, n_components) mm, coefficients less the rest.
    positions_deg : Array
        (n, n_servos) degrees.

    Returns
    -------
    Array
        (n_servos, n_components) degrees per mm.
    """
    ridge = RidgeCV(_RIDGE_STRENGTHS, fit_intercept=False).fit(from_rest, positions_deg)
    coefficients = np.asarray(ridge.coef_, dtype=np.float64)
    return rounded(coefficients.reshape(positions_deg.shape[1], -1))


def _errors(
    model: FaceWithAnimPhos, mouth: RobotMouth, weights: Array, held_out: Array
) -> HoldOutErrors:
    """Return the errors of a linear map on held-out frames of the simulated face.

    weights: (n_servos, n_components) degrees per mm; held_out: (n, n_components) coefficients.
    Joint errors are differences from the best imitating angles.
    """
    human_mm = model.markers_mm(held_out)
    nearest_deg = mouth.nearest_deg(mouth.names.shape_features.of(human_mm))
    free_deg = (held_out - model.rest) @ weights.T
    positions_deg = mouth.limited_deg(free_deg)
    return measure_hold_out(
        human_mm,
        mouth.markers_of(positions_deg),
        mouth.markers_of(nearest_deg),
        positions_deg - nearest_deg,
        (free_deg != positions_deg).any(axis=1),
    )
