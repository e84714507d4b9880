"""The YAML settings of Dynamixel servos and their port; simulated servos use the same keys.

Loads the tables of the models, and nothing that opens a port.
"""

from collections.abc import Mapping
from typing import Annotated, Final, Literal, Self

from pydantic import AfterValidator, model_validator

from firmware_bridge.bus_settings import BusServo, BusSettings, Strict, within
from firmware_bridge.dynamixel.control_table import ServoModel as ModelFacts
from firmware_bridge.dynamixel.control_table import baud_rates, servo_models

#: Volts per step of the voltage registers.
_VOLT_UNIT: Final = 0.1


def _check_baud_rate(value: int) -> int:
    known = sorted(baud_rates().values())
    if value not in known:
        raise ValueError(f"{value} is not a baud rate of these servos; use one of {known}")
    return value


ServoModel = Literal[
    "XL330-M077", "XL330-M288", "XC330-M288", "XC330-T288", "XL430-W250", "XM430-W210", "XM430-W350"
]


class DynamixelSettings(BusSettings):
    """The YAML `bus:` section of a face with Dynamixels, at a serial port or simulated in memory.

    backend: whether our own code or dynamixel-sdk makes the packets.
    """

    baud_rate: Annotated[int, AfterValidator(_check_baud_rate)] = 1_000_000
    backend: Literal["own", "dynamixel-sdk"] = "own"

    @model_validator(mode="after")
    def _real_servos_have_a_port(self) -> Self:
        if self.kind == "dynamixel" and self.port is None:
            raise ValueError("needs `port:`, for example /dev/ttyUSB0 or /dev/serial/by-id/...")
        return self


class _Keys(Strict):
    """The keys that come first in a servo's YAML entry."""

    # Ids a Dynamixel may have: https://emanual.robotis.com/docs/en/dxl/x/xl330-m288/#id
    id: Annotated[int, within(0, 252)]
    model: ServoModel


class DynamixelServo(BusServo, _Keys):
    """One Dynamixel in the YAML of a face.

    max_current_ma: limit of its current; only for models that measure current.
    """

    # No servo moves even itself with less; no X servo takes more.
    max_current_ma: Annotated[float, within(10.0, 5_000.0)] | None = None

    @property
    def facts(self) -> ModelFacts:
        """The facts of the servo's model."""
        return servo_models()[self.model]

    @property
    def ticks_per_deg(self) -> float:
        """Steps of the position register per degree."""
        return self.facts.pulses_per_deg

    @property
    def bounds(self) -> Mapping[str, float | None]:
        """The factory limits of temperature (degC) and voltage (V) of the servo's model."""
        defaults = self.facts.defaults
        return {
            "hottest_degc": defaults["temperature_limit"],
            "least_v": defaults["min_voltage_limit"] * _VOLT_UNIT,
            "most_v": defaults["max_voltage_limit"] * _VOLT_UNIT,
        }

    def strain(self, effort: float) -> float:
        """Return the current at `effort` (share of the stall torque) as a share of max_current_ma.

        0 without max_current_ma, or where the model does not measure current.
        """
        if self.max_current_ma is None or not self.facts.measures_current:
            return 0.0
        return effort * self.facts.stall_a * 1e3 / self.max_current_ma

    @model_validator(mode="after")
    def _the_servo_can_do_it(self) -> Self:
        return self.within_reach(180.0, self.facts.no_load_deg_s)

    @model_validator(mode="after")
    def _the_servo_can_limit_its_current(self) -> Self:
        """Raise ValueError for a max_current_ma above the model's limit.

        Also for any max_current_ma on a model that does not measure current.
        """
        if self.max_current_ma is None:
            return self
        unit_ma = self.facts.current_unit_ma
        if unit_ma is None:
            raise ValueError(f"an {self.model} does not measure current; leave max_current_ma out")
        most_ma = self.facts.defaults["current_limit"] * unit_ma
        if self.max_current_ma > most_ma:
            raise ValueError(
                f"max_current_ma {self.max_current_ma:g} is more than an {self.model} allows "
                f"({most_ma:g} mA)"
            )
        return self
