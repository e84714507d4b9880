"""The kind of bus `dynamixel`: Dynamixel servos at a serial port."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Final

from firmware_bridge.bus_kinds import BusKind, Finding, PortRelease, Wiring
from firmware_bridge.capabilities import BusCapabilities
from firmware_bridge.dynamixel.control_table import CAPABILITIES
from firmware_bridge.dynamixel.settings import DynamixelServo, DynamixelSettings

if TYPE_CHECKING:
    from firmware_bridge.bus import ServoBus
    from firmware_bridge.bus_settings import BusSettings
    from firmware_bridge.clock import Clock
    from firmware_bridge.transport import Transport

#: Without a tick for so many of them, or so long, servos stop by themselves.
_WATCHDOG_TICKS: Final = 3.0
_WATCHDOG_S: Final = 0.1


class DynamixelKind(BusKind):
    """The kind of bus `dynamixel`; `BusKind` describes the methods."""

    name = "dynamixel"
    settings = DynamixelSettings
    servo = DynamixelServo
    workshop_module = "firmware_bridge.dynamixel.provisioning"
    simulator_module = "firmware_bridge.simulator.host"

    def capabilities(self, _settings: "BusSettings") -> BusCapabilities:
        """Return the capabilities of Dynamixels, which report everything."""
        return CAPABILITIES

    def open(self, wiring: Wiring, clock: "Clock", *, strict: bool = True) -> "ServoBus":  # noqa: ARG002 - real servos have the clock of the computer
        """Return the unopened bus of a face's Dynamixels at the port of its settings.

        The setting `backend` selects our own codec or dynamixel-sdk. strict=False: servos may be
        missing. clock: without effect, since the port has its own clock.
        """
        from firmware_bridge.dynamixel.bus import DynamixelBus, slow_adapter
        from firmware_bridge.dynamixel.mounting import mounted_servos
        from firmware_bridge.serial_servos.serial_transport import SameAdapter, latency_timer_ms

        settings, port = wiring.settings, wiring.settings.port

        def remark() -> str | None:
            timer_ms = latency_timer_ms(port)
            return slow_adapter(len(wiring.servos), settings.baud_rate, wiring.rate_hz, timer_ms)

        bus = partial(
            DynamixelBus,
            mounted_servos(wiring),
            watchdog_s=max(_WATCHDOG_TICKS / wiring.rate_hz, _WATCHDOG_S),
            strict=strict,
            adapter_remark=remark,
        )
        if settings.backend == "own":
            return bus(SameAdapter(port, settings.baud_rate))
        from firmware_bridge.dynamixel.wire.sdk_line import SdkLine, SdkTransport

        return bus(SameAdapter(port, settings.baud_rate, SdkTransport), make_line=SdkLine)

    def slowness(self, wiring: Wiring, rate_hz: float) -> str | None:
        """Return why the baud rate is too low for ticks at `rate_hz`; None if it is not."""
        from firmware_bridge.dynamixel.bus import budget

        return budget(len(wiring.servos), wiring.settings.baud_rate, rate_hz)

    def answers_at(self, transport: "Transport") -> bool:
        """Return whether a servo answers a broadcast ping at this transport."""
        from firmware_bridge.dynamixel.wire.line import Line

        return bool(Line(transport).ping_all())

    def port_release(self, port: str, wiring: Wiring | None) -> Callable[[], PortRelease]:
        """Return a function that opens the port and returns a `LineRelease`, to switch torque off.

        Torque off is sent at the baud rate of the face in `wiring`; None: the rate is unknown, and
        all usual rates are tried. The function raises PortError.
        """
        from firmware_bridge.dynamixel.provisioning import SCANNED_RATES
        from firmware_bridge.dynamixel.torque import LineRelease
        from firmware_bridge.serial_servos.serial_transport import SameAdapter

        rates = SCANNED_RATES if wiring is None else (wiring.settings.baud_rate,)
        opener = SameAdapter(port, rates[0])
        return lambda: LineRelease(opener(), rates)

    def examine(self, wiring: Wiring) -> Iterator[Finding]:
        """Open the port and yield findings about adapter, bus and every servo. Raises PortError."""
        from firmware_bridge.dynamixel.doctor import examine
        from firmware_bridge.dynamixel.mounting import mounted_servos
        from firmware_bridge.dynamixel.provisioning import unhurried_line
        from firmware_bridge.serial_servos.serial_transport import latency_timer_ms

        port = wiring.settings.port
        with unhurried_line(port, wiring.settings.baud_rate) as line:
            servos = mounted_servos(wiring)
            yield from examine(line, servos, wiring.rate_hz, latency_timer_ms(port))

    def memories(self, wiring: Wiring) -> Sequence[Mapping[str, int] | None]:
        """Read and return each servo's EEPROM values; None for a servo that does not answer."""
        from firmware_bridge.dynamixel.mounting import identify_all, mounted_servos
        from firmware_bridge.dynamixel.provisioning import unhurried_line

        with unhurried_line(wiring.settings.port, wiring.settings.baud_rate) as line:
            found = identify_all(line, mounted_servos(wiring), strict=False)
        return [None if each is None else each.eeprom for each in found]


DYNAMIXEL: Final = DynamixelKind()
