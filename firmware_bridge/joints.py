"""What the bridge knows of each joint: its name, its servo, and how far and fast it may move."""

import math
from dataclasses import dataclass
from typing import Final

#: A servo's own limits lie so far outside its joint's, so that a joint pushed past its limit by
#: hand can be held where it is. Our choice: a good deal more than any hand moves by accident.
SERVO_LIMIT_MARGIN_DEG: Final = 5.0


#: No farther do pulses go while a person finds a servo's limits: half a turn of most.
SHORTEST_FOUND_US: Final = 500.0
LONGEST_FOUND_US: Final = 2500.0


@dataclass(frozen=True, slots=True)
class JointPulse:
    """The pulse of a hobby servo: neutral_us + us_per_deg x joint degrees, in min_us..max_us.

    A person who searches these limits may go beyond them, to `reach_us`.
    """

    neutral_us: float
    us_per_deg: float
    min_us: float
    max_us: float

    def us(self, joint_deg: float) -> float:
        """Return the pulse for a joint angle, in us."""
        return self.neutral_us + self.us_per_deg * joint_deg

    def deg(self, pulse_us: float) -> float:
        """Return the joint angle for a pulse in us, in degrees."""
        return (pulse_us - self.neutral_us) / self.us_per_deg

    @property
    def reach_us(self) -> tuple[float, float]:
        """The shortest and the longest pulse, us, that a person may use while searching limits."""
        return min(self.min_us, SHORTEST_FOUND_US), max(self.max_us, LONGEST_FOUND_US)

    @property
    def reach_deg(self) -> tuple[float, float]:
        """The joint angles, degrees, of the pulses in `reach_us`, the smaller first."""
        low, high = sorted(self.deg(each) for each in self.reach_us)
        return low, high


@dataclass(frozen=True, slots=True)
class Joint:
    """One servo-driven joint, in joint degrees: 0 = its neutral, between the two limits.

    servo_id: id or channel of its servo on the bus; `address_key` is its key in the YAML.
    max_acceleration_deg_s2: infinite = not limited. critical: without it the whole face stops.
    pulse: of a hobby servo; None for any other servo. Raises ValueError unless min_deg <= 0 <=
    max_deg, max_speed_deg_s > 0, all finite, and max_acceleration_deg_s2 > 0.
    """

    name: str
    servo_id: int
    min_deg: float
    max_deg: float
    max_speed_deg_s: float
    max_acceleration_deg_s2: float = math.inf
    critical: bool = False
    address_key: str = "id"
    pulse: JointPulse | None = None

    def __post_init__(self) -> None:
        """Raise ValueError for limits, speed or acceleration that the class does not allow."""
        if not -math.inf < self.min_deg <= 0.0 <= self.max_deg < math.inf:
            raise ValueError(
                f"joint {self.name!r}: needs min_deg <= 0 <= max_deg, "
                f"got {self.min_deg} and {self.max_deg}"
            )
        if not 0.0 < self.max_speed_deg_s < math.inf:
            raise ValueError(
                f"joint {self.name!r}: max_speed_deg_s must be positive, got {self.max_speed_deg_s}"
            )
        if not self.max_acceleration_deg_s2 > 0.0:
            raise ValueError(
                f"joint {self.name!r}: max_acceleration_deg_s2 must be positive, "
                f"got {self.max_acceleration_deg_s2}"
            )


def named(joint: Joint) -> str:
    """Return how messages refer to a joint's servo, as in `servo 'jaw' (id 1)`."""
    return f"servo {joint.name!r} ({joint.address_key} {joint.servo_id})"
