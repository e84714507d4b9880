"""The YAML settings of Feetech servos and their port."""

from collections.abc import Mapping
from typing import Annotated, Final, Literal, Self

from pydantic import model_validator

from firmware_bridge.bus_settings import BusServo, BusSettings, Strict, within
from firmware_bridge.feetech.control_table import ServoModel, servo_models

#: Largest zero_offset_deg of an SCS servo, which reaches 150 degrees to either side.
_FARTHEST_NEUTRAL_DEG: Final = 90.0


class FeetechSettings(BusSettings):
    """The YAML `bus:` section of a face of Feetech servos; without a port, simulated in memory."""

    kind: str = "feetech"
    baud_rate: Literal[1_000_000, 500_000, 250_000, 128_000, 115_200] = 1_000_000


class _Keys(Strict):
    """The keys that come first in a servo's YAML entry."""

    id: Annotated[int, within(0, 253)]
    model: Literal["STS3215", "STS3250", "SCS0009"]


class FeetechServo(BusServo, _Keys):
    """One Feetech servo in the YAML of a face."""

    @property
    def facts(self) -> ServoModel:
        """The facts of the servo's model."""
        return servo_models()[self.model]

    @property
    def ticks_per_deg(self) -> float:
        """Steps of the position register per degree."""
        return self.facts.pulses_per_deg

    @property
    def bounds(self) -> Mapping[str, float | None]:
        """Temperature (degC) and voltage (V) limits of the servo's model, in its widest variant."""
        facts = self.facts
        return {
            "hottest_degc": facts.hottest_degc,
            "least_v": facts.least_v,
            "most_v": facts.most_v,
        }

    @model_validator(mode="after")
    def _the_servo_can_do_it(self) -> Self:
        """Raise ValueError if the model cannot reach the joint's limits, or is not fast enough.

        For an SCS also if `zero_offset_deg` puts neutral near an end of the servo's range.
        """
        if self.facts.dialect.name == "scs" and abs(self.zero_offset_deg) > _FARTHEST_NEUTRAL_DEG:
            raise ValueError(
                f"zero_offset_deg {self.zero_offset_deg:g} puts neutral near the end of an "
                f"{self.model}'s range (`new-face --ranges` of 0.3.0 did so by mistake); make the "
                "face again, or turn the horn"
            )
        return self.within_reach(self.facts.dialect.reach_deg / 2, self.facts.fastest_deg_s)
