"""The kind of bus `feetech`: Feetech servos at a serial port."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Final

from firmware_bridge.bus_kinds import BusKind, Finding, PortRelease, Wiring
from firmware_bridge.capabilities import SERIAL_SERVOS, BusCapabilities
from firmware_bridge.feetech.settings import FeetechServo, FeetechSettings

if TYPE_CHECKING:
    from firmware_bridge.bus import ServoBus
    from firmware_bridge.bus_settings import BusSettings
    from firmware_bridge.clock import Clock
    from firmware_bridge.transport import Transport


class FeetechKind(BusKind):
    """The kind of bus `feetech`; `BusKind` describes the methods."""

    name = "feetech"
    settings = FeetechSettings
    servo = FeetechServo
    workshop_module = "firmware_bridge.feetech.provisioning"
    simulator_module = "firmware_bridge.feetech.simulator"

    def capabilities(self, settings: "BusSettings") -> BusCapabilities:
        """Return all capabilities but a watchdog; without a port, those of servos in memory.

        When the computer dies these servos go on to the goal sent last, and hold.
        """
        if settings.port is None:
            return replace(SERIAL_SERVOS, in_memory=True, memory=False, set_up=False)
        return SERIAL_SERVOS

    def open(self, wiring: Wiring, clock: "Clock", *, strict: bool = True) -> "ServoBus":
        """Return the face's unopened bus at its port; without a port, one simulated in memory.

        strict=False: servos may be missing. clock: moves the simulated servos; a port has its own.
        """
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
        """Return why the baud rate is too low for ticks at `rate_hz`; None if it is not."""
        from firmware_bridge.feetech.bus import budget
        from firmware_bridge.feetech.mounting import mounted_servos

        return budget(mounted_servos(wiring), wiring.settings.baud_rate, rate_hz)

    def answers_at(self, transport: "Transport") -> bool:
        """Return whether any id answers a read of its model number at this transport."""
        from firmware_bridge.feetech.line import Line

        return bool(Line(transport).scan())

    def port_release(self, port: str, wiring: Wiring | None) -> Callable[[], PortRelease]:
        """Return a function that opens the port and returns a `LineRelease`, to switch torque off.

        Torque off is sent at the baud rate of the face in `wiring`; None: the rate is unknown, and
        all rates of these servos are tried. The function raises PortError.
        """
        from firmware_bridge.feetech.control_table import baud_rates
        from firmware_bridge.feetech.torque import LineRelease
        from firmware_bridge.serial_servos.serial_transport import SameAdapter

        rates = tuple(baud_rates().values()) if wiring is None else (wiring.settings.baud_rate,)
        opener = SameAdapter(port, rates[-1])  # the slowest, which any adapter can do
        return lambda: LineRelease(opener(), rates)

    def examine(self, wiring: Wiring) -> Iterator[Finding]:
        """Open the port and yield findings about bus and every servo. Raises PortError."""
        from firmware_bridge.feetech.doctor import examine
        from firmware_bridge.feetech.mounting import mounted_servos
        from firmware_bridge.feetech.provisioning import unhurried_line

        with unhurried_line(wiring.settings.port, wiring.settings.baud_rate) as line:
            yield from examine(line, mounted_servos(wiring), wiring.rate_hz)

    def memories(self, wiring: Wiring) -> Sequence[Mapping[str, int] | None]:
        """Read and return each servo's EEPROM values; None for a servo that does not answer.

        Empty without a port, for servos in memory. `drive_mode` is register `phase` here, so that
        the keys are those of Dynamixels.
        """
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
