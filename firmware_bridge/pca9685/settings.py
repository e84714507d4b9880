"""The `bus:` and `servos:` sections of a face YAML for hobby servos at a PCA9685."""

from collections.abc import Mapping
from typing import Annotated, Any, Final, Self

from pydantic import AfterValidator, model_validator

from firmware_bridge.bus_settings import BusSettings, Text, within
from firmware_bridge.pca9685.registers import N_CHANNELS, NOMINAL_CLOCK_HZ, Timing
from firmware_bridge.pulse_servos import LONGEST_US, PulseServo

#: The pause that a servo needs between two pulses to tell them apart.
_PAUSE_US: Final = 200.0


def _check_address(value: int) -> int:
    # 7.1.1: six solder bridges. 0x70 is the all-call address of every chip that was not set up.
    if not 0x40 <= value <= 0x7F or value == 0x70:
        raise ValueError(f"PCA9685 address {value:#04x} is not 0x40..0x6f or 0x71..0x7f")
    return value


class Pca9685Settings(BusSettings):
    """The YAML `bus:` section of a face whose servos are connected to a PCA9685.

    port: the bus's file in Linux; default: that of `i2c_bus`; without either the servos are
    simulated in memory. frequency_hz: of the pulses. clock_hz: as measured at this board. oe_gpio:
    the line of `gpio_chip` that leads to the board's OE pin; None: nothing is connected to that
    pin.
    """

    kind: str = "pca9685"
    i2c_bus: Annotated[int, within(0, 255)] | None = None
    address: Annotated[int, AfterValidator(_check_address)] = 0x40
    frequency_hz: Annotated[float, within(50.0, 330.0)] = 50.0
    clock_hz: Annotated[float, within(20e6, 30e6)] = float(NOMINAL_CLOCK_HZ)
    oe_gpio: Annotated[int, within(0, 1023)] | None = None
    gpio_chip: Text = "/dev/gpiochip0"

    @property
    def board(self) -> str:
        """The chip's address on the I2C bus as text, such as `0x40`."""
        return f"{self.address:#04x}"

    @property
    def timing(self) -> Timing:
        """The chip's clock and the prescaler for pulses at `frequency_hz`."""
        return Timing.at(self.clock_hz, self.frequency_hz)

    @model_validator(mode="before")
    @classmethod
    def _its_bus_is_its_port(cls, content: Any) -> Any:
        number = content.get("i2c_bus") if isinstance(content, Mapping) else None
        if isinstance(number, int) and content.get("port") is None:
            return {**content, "port": f"/dev/i2c-{number}"}
        return content


class Pca9685Servo(PulseServo):
    """The settings of a hobby servo at one of the sixteen channels of a PCA9685."""

    @model_validator(mode="after")
    def _the_chip_can_do_it(self) -> Self:
        if self.channel >= N_CHANNELS:
            raise ValueError(f"channel {self.channel} is outside 0..{N_CHANNELS - 1}")
        return self


def check_pulses(settings: Pca9685Settings, longest_us: float) -> str:
    """Return why a pulse of `longest_us` and a pause do not fit into a period; empty: they fit."""
    room_us = settings.timing.period_us - _PAUSE_US
    if min(longest_us, LONGEST_US) <= room_us:
        return ""
    return (
        f"max_us {longest_us:g} does not fit between pulses of {settings.frequency_hz:g} Hz, "
        f"{room_us:.0f} us; lower frequency_hz"
    )
