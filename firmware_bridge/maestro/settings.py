"""What a face YAML says of a Maestro and its servos."""

from typing import Annotated, Any, Literal

from pydantic import model_validator

from firmware_bridge.bus_settings import BusSettings, within
from firmware_bridge.maestro.protocol import N_CHANNELS


class MaestroSettings(BusSettings):
    """`bus:` of a face whose servos hang on a Maestro, on its USB command port.

    Without `port:` it is simulated in memory.
    crc: as the Maestro is set. device: its number where several share a port; None: it is alone.
    serial_timeout_s: as the Maestro is set: without a command for so long it stops its pulses; 0:
    never, as they come, but firmware/pico_maestro has .5 s.
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
        """Its number, where it has one."""
        return "" if self.device is None else f"device {self.device}"

    @property
    def n_channels(self) -> int:
        """How many servos it has room for."""
        return N_CHANNELS[self.model]
