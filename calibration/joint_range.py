"""A joint as calibration sees it."""

import math
from dataclasses import dataclass

from calibration.calibration import CalibrationError


@dataclass(frozen=True, slots=True)
class JointRange:
    """One servo as a calibration sees it, in joint degrees; 0 = its neutral = closed mouth.

    Raises CalibrationError unless min_deg <= 0 <= max_deg, both finite.
    """

    name: str
    min_deg: float
    max_deg: float

    def __post_init__(self) -> None:
        if not -math.inf < self.min_deg <= 0.0 <= self.max_deg < math.inf:
            raise CalibrationError(
                f"servo {self.name!r}: needs min_deg <= 0 <= max_deg, "
                f"got {self.min_deg} and {self.max_deg}"
            )
