"""The servos of one mouth, as the fits need them from its face YAML."""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calibration.calibration import (
    Calibration,
    CalibrationError,
    CouplingRule,
    linear_calibration_parts,
)
from lipsync.arrays import Array
from lipsync.face.model import FaceModel

#: A servo farther from its goal than this after settling has met something. A few times what a
#: proportional controller leaves under the pull of a skin.
STALL_DEG = 3.0


@dataclass(frozen=True, slots=True)
class JointRange:
    """A joint's range in degrees from neutral (0, the closed mouth), and its servo's name.

    Raises CalibrationError unless min_deg <= 0 <= max_deg, both finite.
    """

    name: str
    min_deg: float
    max_deg: float

    def __post_init__(self) -> None:
        if not -math.inf < self.min_deg <= 0.0 <= self.max_deg < math.inf:
            raise CalibrationError(
                f"servo {self.name!r}: needs min_deg <= 0 <= max_deg, got {self.min_deg} and "
                f"{self.max_deg}"
            )


@dataclass(frozen=True, slots=True)
class MouthServos:
    """The joints of a mouth, in the order of the face YAML, with their servos and rules.

    models: one servo model per joint; positive: one word per joint for what a positive angle does,
    which lets a reversed joint be found. Both may be empty where unknown. rules: coupling rules.
    """

    joints: tuple[JointRange, ...]
    face_checksum: str = ""
    models: tuple[str, ...] = ()
    positive: tuple[str, ...] = ()
    rules: tuple[CouplingRule, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the servos, one per joint."""
        return tuple(joint.name for joint in self.joints)

    def holding(self, still: Collection[int]) -> "MouthServos":
        """Return the servos with the joints numbered in `still` limited to 0 degrees."""
        held = tuple(
            JointRange(joint.name, 0.0, 0.0) if number in still else joint
            for number, joint in enumerate(self.joints)
        )
        return replace(self, joints=held)

    @property
    def limits_deg(self) -> tuple[Array, Array]:
        """The least and the most angle of each joint.

        Returns
        -------
        tuple[Array, Array]
            (n_servos,) degrees each.
        """
        return limits_of(self.joints)


def limits_of(joints: Sequence[JointRange]) -> tuple[Array, Array]:
    """Return the least and the most angle of joints.

    Returns
    -------
    tuple[Array, Array]
        (n_servos,) degrees each.
    """
    ends = np.array([(joint.min_deg, joint.max_deg) for joint in joints]).reshape(-1, 2)
    return ends[:, 0].copy(), ends[:, 1].copy()


def linear_calibration(
    model: FaceModel, servos: MouthServos, weights: Array, **others: Any
) -> Calibration:
    """Return a calibration, with a linear map that is 0 degrees at rest unless `others` says else.

    Parameters
    ----------
    model : FaceModel
        The speaker's face model.
    servos : MouthServos
        The mouth's joints.
    weights : Array
        (n_servos, n_components) degrees per mm of a coefficient.
    others : Any
        Fields of the calibration, `errors` at least.
    """
    quadratic_weights, rest_deg, x_range = linear_calibration_parts(*weights.shape)
    min_deg, max_deg = servos.limits_deg
    linear = {
        "servo_names": servos.names,
        "weights": weights,
        "quadratic_weights": quadratic_weights,
        "rest": model.rest,
        "rest_deg": rest_deg,
        "x_range": x_range,
        "min_deg": min_deg,
        "max_deg": max_deg,
        "model_checksum": model.checksum,
        "face_checksum": servos.face_checksum,
    }
    return Calibration(**{**linear, **others})
