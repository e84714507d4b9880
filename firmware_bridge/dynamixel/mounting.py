"""A servo in its place in the face: joint degrees to the servo's own pulses and back."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from firmware_bridge.bus import Array
from firmware_bridge.dynamixel.control_table import CENTER_PULSE, PULSES_PER_DEG, ServoModel
from firmware_bridge.joints import Joint


@dataclass(frozen=True, slots=True)
class MountedServo:
    """One servo and the joint it drives. servo angle = sign x (joint angle + zero_offset_deg).

    max_current_ma: it never pulls harder (operating mode 5); None: as hard as it can (mode 3).
    Raises ValueError for a current limit on a model that does not measure current.
    """

    joint: Joint
    model: ServoModel
    sign: int = 1
    zero_offset_deg: float = 0.0
    max_current_ma: float | None = None

    def __post_init__(self) -> None:
        if self.max_current_ma is not None and not self.model.measures_current:
            raise ValueError(
                f"joint {self.joint.name!r}: an {self.model.name} does not measure current, "
                "so max_current_ma cannot be kept"
            )

    @property
    def current_cap(self) -> int | None:
        """The most that goal_current may be, in the register's unit; None: no cap."""
        unit_ma = self.model.current_unit_ma
        if self.max_current_ma is None or unit_ma is None:
            return None
        return max(1, int(self.max_current_ma / unit_ma))

    def pulse(self, joint_deg: float) -> int:
        """The position register's value for a joint angle."""
        return round(CENTER_PULSE + self.sign * (joint_deg + self.zero_offset_deg) * PULSES_PER_DEG)

    def pulse_range(self) -> tuple[int, int]:
        """The joint's soft limits in pulses, the smaller first."""
        ends = self.pulse(self.joint.min_deg), self.pulse(self.joint.max_deg)
        return min(ends), max(ends)


class Mounting:
    """All servos of a face at once. Arrays are (n_servos,)."""

    def __init__(self, servos: Sequence[MountedServo]) -> None:
        self._scale = np.array([servo.sign * PULSES_PER_DEG for servo in servos])
        offset = np.array([servo.zero_offset_deg for servo in servos])
        self._zero = CENTER_PULSE + offset * self._scale

    def pulses(self, joint_deg: Array) -> Array:
        """Whole pulses, as floats: what is not finite stays so."""
        pulses: Array = np.rint(self._zero + joint_deg * self._scale)
        return pulses

    def joint_deg(self, pulses: Array) -> Array:
        """Joint degrees; NaN stays NaN."""
        joint_deg: Array = (pulses - self._zero) / self._scale
        return joint_deg

    def one_deg(self, index: int, pulse: float) -> float:
        """Joint degrees of one servo's position register."""
        return float((pulse - self._zero[index]) / self._scale[index])
