"""The `bus:` section of a face YAML for hobby servos at a Pololu Maestro."""

from typing import Annotated, Any, Literal

from pydantic import model_validator

from firmware_bridge.bus_settings import BusSettings, within
from firmware_bridge.maestro.protocol import N_CHANNELS


class MaestroSettings(BusSettings):
    """The YAML `bus:` section of a face with servos at a Maestro, driven by its USB command port.

    Without `port:` the servos are simulated in memory.
    crc: whether the Maestro is set to require a CRC. device: the Maestro's number where several
    share a port; None: it is alone. serial_timeout_s: the time set in the Maestro after which it
    stops its pulses if no command comes; 0: it never does (factory setting). By default .5 s for
    model `pico`, the firmware in firmware/pico_maestro.
    """

    kind: str = "maestro"
    model: Literal["micro6", "mini12", "mini18", "mini24", "pico"]
    crc: bool = False
    device: Annotated[int, within(0, 127)] | None = None
    #: The Maestro counts it in hundredths, 16 bits.
    serial_timeout_s: Annotated[float, within(0.0, 655.35)] = 0.0

    @model_validator(mode="before")
    @classmethod
    def _set_timeout_of_the_pico(cls, value: Any) -> Any:
        is_pico = isinstance(value, dict) and value.get("model") == "pico"
        return {"serial_timeout_s": 0.5, **value} if is_pico else value

    @property
    def board(self) -> str:
        """The Maestro's device number as text, such as `device 12`; empty without a number."""
        return "" if self.device is None else f"device {self.device}"

    @property
    def n_channels(self) -> int:
        """The number of servo channels of the Maestro model."""
        return N_CHANNELS[self.model]
