"""Servos in memory as a kind of bus: a Dynamixel face without its servos."""

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
    """Written down as Dynamixels are, so that `--port` is all that it takes to drive real ones."""

    name = "simulated"
    at_port = "dynamixel"

    def capabilities(self, _settings: "BusSettings") -> BusCapabilities:
        """The capabilities of servos that are moved by a clock alone."""
        return IN_MEMORY

    def open(self, wiring: Wiring, clock: "Clock", *, strict: bool = True) -> "ServoBus":  # noqa: ARG002 - nobody is missing
        """Open the simulated bus; never refuses, since no servo is missing."""
        from firmware_bridge.simulator.bus import SimulatedBus

        return SimulatedBus(wiring.joints, clock, capabilities=wiring.capabilities or IN_MEMORY)

    def memories(self, _wiring: Wiring) -> Sequence[Mapping[str, int] | None]:
        """None to be known by."""
        return ()


SIMULATED: Final = SimulatedKind()
