"""The map from one model's face motion to one robot's servo angles."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.hold_out import HoldOutErrors
from lipsync.animpho.model import FaceModel
from lipsync.errors import UserError

Array = NDArray[np.float64]

_REMEDY = "run `lipservo calibrate --config FACE -o FILE`"
#: Models keep their rest in float32, about 1e-6 of a coefficient; any other rest is another mouth.
_REST_TOLERANCE = 1e-4


class CalibrationError(UserError):
    """A calibration that cannot be made or used: says which, why, and what to do."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """Linear from the model's rest: angles = weights @ (coefficients - rest), within the limits.

    weights: (n_servos, n_components), degrees; rest: (n_components,), where all servos are at 0;
    min_deg, max_deg: (n_servos,), the face's limits at the time of the fit.
    """

    servo_names: tuple[str, ...]
    weights: Array
    rest: Array
    min_deg: Array
    max_deg: Array
    errors: HoldOutErrors
    model_checksum: str
    face_checksum: str

    def positions_deg(self, coefficients: Array) -> Array:
        """(n_components,) -> (n_servos,) joint degrees, in the order of `servo_names`."""
        free_deg = self.weights @ (coefficients - self.rest)
        return np.minimum(np.maximum(free_deg, self.min_deg), self.max_deg)


def check_calibration(
    calibration: Calibration, model: FaceModel, servo_names: Sequence[str], face_checksum: str
) -> None:
    """Raises CalibrationError, with the remedy, unless made for this model and this very face."""
    for name in servo_names:
        if name not in calibration.servo_names:
            raise CalibrationError(f"servo {name!r} has no calibration; {_REMEDY}")
    for name in calibration.servo_names:
        if name not in servo_names:
            raise CalibrationError(f"calibrated servo {name!r} is not in this face; {_REMEDY}")
    if calibration.model_checksum != model.checksum:
        raise CalibrationError(
            f"calibration was made for model {calibration.model_checksum}, "
            f"this is model {model.checksum}; {_REMEDY}"
        )
    if not np.allclose(calibration.rest, model.rest, rtol=0.0, atol=_REST_TOLERANCE):
        raise CalibrationError(f"calibration was made for another closed mouth; {_REMEDY}")
    if calibration.face_checksum != face_checksum or calibration.servo_names != tuple(servo_names):
        raise CalibrationError(
            f"calibration was made for face {calibration.face_checksum}, "
            f"this is face {face_checksum}: its servos or limits have changed since; {_REMEDY}"
        )
