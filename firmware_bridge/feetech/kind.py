"""Feetech servos at a serial port, as one kind of bus."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from firmware_bridge.bus_kinds import BusKind, Finding, PortRelease, Wiring
from firmware_bridge.capabilities import BusCapabilities
from firmware_bridge.feetech.control_table import CAPABILITIES
from firmware_bridge.feetech.settings import FeetechServo, FeetechSettings

if TYPE_CHECKING:
    from firmware_bridge.bus import ServoBus
    from firmware_bridge.bus_settings import BusSettings
    from firmware_bridge.clock import Clock
    from firmware_bridge.transport import Transport


class FeetechKind(BusKind):
    """See `BusKind`."""

    name = "feetech"
    settings = FeetechSettings
    servo = FeetechServo
    workshop_module = "firmware_bridge.feetech.provisioning"
    simulator_module = "firmware_bridge.feetech.simulator"

    def capabilities(self, settings: "BusSettings") -> BusCapabilities:
        """All but a watchdog: when the computer dies they go on to the goal sent last, and hold."""
        if settings.port is None:
            return replace(CAPABILITIES, in_memory=True, memory=False, set_up=False)
        return CAPABILITIES

    def open(self, wiring: Wiring, clock: "Clock", *, strict: bool = True) -> "ServoBus":
        """Open the bus at its port; without one in memory."""
        from firmware_bridge.feetech.bus import FeetechBus
        from firmware_bridge.feetech.mounting import mounted_servos

        servos, settings = mounted_servos(wiring), wiring.settings
        if settings.port is None:
            from firmware_bridge.simulator.bus import SimulatedBus

            return SimulatedBus(wiring.joints, clock, capabilities=self.capabilities(settings))
        from firmware_bridge.serial_servos.serial_transport import SameAdapter

        opener = SameAdapter(settings.port, settings.baud_rate)
        return FeetechBus(servos, opener, strict=strict, period_s=1.0 / wiring.rate_hz)

    def slowness(self, wiring: Wiring, rate_hz: float) -> str | None:
        """Return why the rate is too high for the bytes of a tick; empty: it is not."""
        from firmware_bridge.feetech.bus import budget
        from firmware_bridge.feetech.mounting import mounted_servos

        return budget(mounted_servos(wiring), wiring.settings.baud_rate, rate_hz)

    def answers_at(self, transport: "Transport") -> bool:
        """Whether any id answers a read of its model number."""
        from firmware_bridge.feetech.line import Line

        return bool(Line(transport).scan())

    def port_release(self, port: str, wiring: Wiring | None) -> Callable[[], PortRelease]:
        """At the face's rate; where that is not known, at all usual ones."""
        from firmware_bridge.feetech.control_table import baud_rates
        from firmware_bridge.feetech.torque import LineRelease
        from firmware_bridge.serial_servos.serial_transport import SameAdapter

        rates = tuple(baud_rates().values()) if wiring is None else (wiring.settings.baud_rate,)
        opener = SameAdapter(port, rates[0])
        return lambda: LineRelease(opener(), rates)

    def examine(self, wiring: Wiring) -> Iterator[Finding]:
        """Port, adapter, and every servo."""
        from firmware_bridge.feetech.doctor import examine
        from firmware_bridge.feetech.mounting import mounted_servos
        from firmware_bridge.feetech.provisioning import unhurried_line

        with unhurried_line(wiring.settings.port, wiring.settings.baud_rate) as line:
            yield from examine(line, mounted_servos(wiring), wiring.rate_hz)

    def memories(self, wiring: Wiring) -> Sequence[Mapping[str, int] | None]:
        """Read the EEPROM of each servo."""
        from firmware_bridge.feetech.mounting import identify_all, mounted_servos
        from firmware_bridge.feetech.provisioning import unhurried_line

        if wiring.settings.port is None:
            return ()
        with unhurried_line(wiring.settings.port, wiring.settings.baud_rate) as line:
            found = identify_all(line, mounted_servos(wiring), strict=False)
        return [
            {"homing_offset": 0, "drive_mode": each.eeprom["phase"]} | each.eeprom if each else None
            for each in found
        ]


FEETECH: Final = FeetechKind()
