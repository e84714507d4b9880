"""The textbook's way from the same capture: ridge from angles to markers, bounded least squares.

It is given the wanted shapes as they are defined, the robot's own closed gap and scale included,
which a calibration has to find out.
"""

import numpy as np
from sklearn.linear_model import RidgeCV
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import PolynomialFeatures, StandardScaler

from calibration.capture.capture import Capture
from calibration.mouth_servos import MouthServos
from calibration.run.inverse import nearest_poses_deg
from lipservo_lab.bench.calibration.wanted_shapes import NAMES
from lipsync.arrays import Array

_STRENGTHS = np.logspace(-3, 3, 13)


def rival_poses_deg(capture: Capture, servos: MouthServos, features: Array, degree: int) -> Array:
    """(n, n_features) -> (n, n_servos). degree: of the polynomial in the angles."""
    ridge = make_pipeline(
        PolynomialFeatures(degree, include_bias=False), StandardScaler(), RidgeCV(_STRENGTHS)
    )
    usual_mm = np.nanmedian(capture.markers_mm, axis=0)
    seen_mm = np.where(np.isfinite(capture.markers_mm), capture.markers_mm, usual_mm)
    fitted = ridge.fit(capture.goals_deg, seen_mm.reshape(len(capture), -1))

    def markers_of(angles_deg: Array) -> Array:
        return np.asarray(fitted.predict(angles_deg)).reshape(len(angles_deg), -1, 3)

    return nearest_poses_deg(markers_of, features, NAMES.shape_features, servos.limits_deg)
