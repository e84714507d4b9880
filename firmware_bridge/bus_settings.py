"""The parts of a face YAML that a bus reads: its own section, and the entry of one servo.

Every kind of bus derives its own settings from these (`firmware_bridge.bus_kinds`).
"""

from collections.abc import Mapping
from typing import Annotated, ClassVar, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, StringConstraints, model_validator

from firmware_bridge.joints import JointPulse


def within(low: float, high: float) -> AfterValidator:
    """Return a validator for numbers from `low` to `high`; its error message names both ends."""

    def check(value: float) -> float:
        if not low <= value <= high:
            raise ValueError(f"{value:g} is outside {low:g}..{high:g}")
        return value

    return AfterValidator(check)


def _check_sign(value: int) -> int:
    if value not in (1, -1):
        raise ValueError(f"{value} must be 1 or -1")
    return value


#: Half a turn to each side.
Degrees = Annotated[float, within(-180.0, 180.0)]
Text = Annotated[str, StringConstraints(min_length=1)]


class Strict(BaseModel):
    """Base model: no unknown key, no conversion between types, no change after reading."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class BusSettings(Strict):
    """The bus section of a face YAML. kind: a name of `firmware_bridge.bus_kinds`.

    port: path of the serial device; None: no port, as for servos simulated in memory.
    """

    kind: str = "simulated"
    port: Text | None = None

    @property
    def board(self) -> str:
        """Text that identifies the board among several at one port, such as `device 12`.

        Empty for a kind of bus with one board a port.
        """
        return ""


class BusServo(Strict):
    """One servo and the joint it drives, in joint degrees: 0 = the joint's neutral.

    `positive` describes in a word what a positive angle does. The servo's own angle is sign x
    (joint angle + zero_offset_deg).
    """

    #: The key that tells the servos of one bus apart.
    address_key: ClassVar[str] = "id"

    positive: Text
    min_deg: Degrees
    max_deg: Degrees
    # The fastest servo known here, XL330-M077-T, makes 383 rev/min without load at 5 V (its
    # e-manual page). Slower than 1 deg/s no mouth speaks, and Ctrl-C would not bring it home.
    max_speed_deg_s: Annotated[float, within(1.0, 2298.0)]
    # Not a Literal: that would take `true` for 1.
    sign: Annotated[int, AfterValidator(_check_sign)] = 1
    zero_offset_deg: Degrees = 0.0
    # Top speed within 50 ms at least, or speech is lost; within a millisecond is no limit any more.
    max_acceleration_deg_s2: Annotated[float, within(100.0, 2_000_000.0)] | None = None

    @property
    def address(self) -> int:
        """The servo's id or channel, by which the bus finds it: the value of `address_key`."""
        return int(getattr(self, self.address_key))

    @property
    def make(self) -> str | None:
        """The servo model named in the YAML; None if it names none."""
        return getattr(self, "model", None)

    @property
    def ticks_per_deg(self) -> float | None:
        """Steps of the servo's position register per degree; None: it has no such register."""
        return None

    @property
    def pulse(self) -> JointPulse | None:
        """Pulse and range of a hobby servo; None for a servo of any other kind."""
        return None

    @property
    def bounds(self) -> Mapping[str, float | None]:
        """Limits of the servo model: hottest_degc, least_v, most_v; None where none is stated."""
        return {"hottest_degc": None, "least_v": None, "most_v": None}

    def strain(self, _effort: float) -> float:
        """Return the current at an effort, a share of the stall torque, as a share of its limit.

        0 where current or limit is unknown.
        """
        return 0.0

    def within_reach(self, reach_deg: float, fastest_deg_s: float) -> Self:
        """Return `self` if the servo reaches all of the joint's range; raise ValueError otherwise.

        reach_deg: how far the servo turns to each side. fastest_deg_s: its speed without load,
        which max_speed_deg_s must not exceed.
        """
        # The last step of the register; what is half a step beyond would be rounded past it.
        most_deg = reach_deg - (0.5 / self.ticks_per_deg if self.ticks_per_deg else 0.0)
        for name, angle in (("min_deg", self.min_deg), ("max_deg", self.max_deg)):
            servo_deg = self.sign * (angle + self.zero_offset_deg)
            if not -reach_deg <= servo_deg < most_deg:
                raise ValueError(
                    f"{name} puts the servo at {servo_deg:g} deg; "
                    f"it reaches -{reach_deg:g}..{most_deg:g}"
                )
        if self.max_speed_deg_s > fastest_deg_s:
            raise ValueError(
                f"max_speed_deg_s {self.max_speed_deg_s:g} is faster than an {self.make} turns "
                f"without load ({fastest_deg_s:g} deg/s); lower it"
            )
        return self

    @model_validator(mode="after")
    def _neutral_is_within_reach(self) -> Self:
        if not self.min_deg <= 0.0 <= self.max_deg:
            raise ValueError(
                f"needs min_deg <= 0 <= max_deg, got {self.min_deg:g} and {self.max_deg:g}"
            )
        return self
