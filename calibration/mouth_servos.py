"""The servos of one mouth as its face YAML describes them: what every fit needs to know of them."""

from dataclasses import dataclass

import numpy as np

from calibration.coupling_rule import CouplingRule
from calibration.joint_range import JointRange
from lipsync.arrays import Array


@dataclass(frozen=True, slots=True)
class MouthServos:
    """Joints in the order of the YAML, with what belongs to them.

    models: one servo model a joint; positive: what a positive angle does, one word a joint, which
    lets a reversed joint be found. Both may be empty where nobody knows. rules: what the joints
    must not do together.
    """

    joints: tuple[JointRange, ...]
    face_checksum: str = ""
    models: tuple[str, ...] = ()
    positive: tuple[str, ...] = ()
    rules: tuple[CouplingRule, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """One a joint."""
        return tuple(joint.name for joint in self.joints)

    @property
    def limits_deg(self) -> tuple[Array, Array]:
        """Least and most degrees, (n_servos,) each."""
        return (
            np.array([joint.min_deg for joint in self.joints]),
            np.array([joint.max_deg for joint in self.joints]),
        )
