"""The kind of servo bus `simulated`: servos in memory with the YAML settings of Dynamixels."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final

from firmware_bridge.bus_kinds import Wiring
from firmware_bridge.capabilities import IN_MEMORY, BusCapabilities
from firmware_bridge.dynamixel.kind import DynamixelKind

if TYPE_CHECKING:
    from firmware_bridge.bus import ServoBus
    from firmware_bridge.bus_settings import BusSettings
    from firmware_bridge.clock import Clock


class SimulatedKind(DynamixelKind):
    """The kind `simulated`: settings as for Dynamixels, so that `--port` alone drives real ones."""

    name = "simulated"
    at_port = "dynamixel"

    def capabilities(self, _settings: "BusSettings") -> BusCapabilities:
        """Return the capabilities of servos simulated in memory."""
        return IN_MEMORY

    def open(self, wiring: Wiring, clock: "Clock", *, strict: bool = True) -> "ServoBus":  # noqa: ARG002 - nobody is missing
        """Return the simulated bus, which must be entered by `with`; strict: without effect."""
        from firmware_bridge.simulator.bus import SimulatedBus

        return SimulatedBus(wiring.joints, clock, capabilities=wiring.capabilities or IN_MEMORY)

    def memories(self, _wiring: Wiring) -> Sequence[Mapping[str, int] | None]:
        """Return no memories: simulated servos keep no settings of their own."""
        return ()


SIMULATED: Final = SimulatedKind()
