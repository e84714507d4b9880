"""The kind of bus `maestro`: hobby servos on a Pololu Maestro."""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from firmware_bridge.bus_kinds import BusKind, Finding, PortRelease, Severity, Wiring
from firmware_bridge.capabilities import SOFT_START_S, BusCapabilities
from firmware_bridge.maestro.settings import MaestroSettings
from firmware_bridge.pulse_bus import PULSES_OFF, STAGGER_S, usb_product
from firmware_bridge.pulse_servos import PulseServo

if TYPE_CHECKING:
    from firmware_bridge.bus import ServoBus
    from firmware_bridge.bus_settings import BusSettings
    from firmware_bridge.clock import Clock

CAPABILITIES: Final = BusCapabilities(
    hold=True,
    profile=True,
    soft_start_s=SOFT_START_S,
    stagger_s=STAGGER_S,
    pulse_rate_hz=50.0,
    released_words=PULSES_OFF,
)
#: Any rate will do: over USB the baud rate has no effect.
BAUD_RATE: Final = 115_200
#: Vendor and products: https://www.pololu.com/docs/0J40 , the Micro Maestro and the three Minis.
_USB_PRODUCTS: Final = ("1ffb:0089", "1ffb:008a", "1ffb:008b", "1ffb:008c")
_DEAD_COMPUTER: Final = (
    "its serial timeout is off, as it comes: when the computer dies the servos are held at the "
    "goal sent last"
)
_SET_TIMEOUT: Final = (
    "in Pololu's Control Center set Timeout to .5 s and every channel to Off on startup or error; "
    "then write serial_timeout_s: 0.5 under bus:"
)


class MaestroKind(BusKind):
    """The kind of bus `maestro`; `BusKind` describes the methods."""

    name = "maestro"
    settings = MaestroSettings
    servo = PulseServo
    board_key = "model"
    usual_board = "micro6"
    simulator_module = "firmware_bridge.maestro.simulator"

    def capabilities(self, settings: "BusSettings") -> BusCapabilities:
        """Return what servos can do: they report nothing; a watchdog if serial_timeout_s is set."""
        timeout_s = getattr(settings, "serial_timeout_s", 0.0)
        return replace(CAPABILITIES, watchdog=timeout_s > 0.0, in_memory=settings.port is None)

    def open(self, wiring: Wiring, clock: "Clock", *, strict: bool = True) -> "ServoBus":  # noqa: ARG002 - a servo that is missing cannot be told from one that is there
        """Return the face's unopened bus at its command port; without a port, simulated in memory.

        strict: without effect. clock: for times of pulses and of simulated motion. Raises
        ServoError for channels that the model lacks.
        """
        from firmware_bridge.maestro.controller import MaestroController, check_channels
        from firmware_bridge.pulse_bus import KeptPulses, PulseBus

        check_channels(wiring)
        settings, can = wiring.settings, self.capabilities(wiring.settings)
        if settings.port is None:
            from firmware_bridge.simulator.bus import SimulatedBus

            return SimulatedBus(wiring.joints, clock, capabilities=can)
        controller = MaestroController(wiring, _opener(settings.port))
        # may_jump: servos may start without a known position. Simulated ones always may.
        may_jump = wiring.may_jump or Path(settings.port).resolve().parent == Path("/dev/pts")
        kept = KeptPulses(wiring.kept)
        return PulseBus(wiring.servos, controller, clock, can, kept, may_jump=may_jump)

    def is_at(self, port: str) -> bool:
        """Return whether the USB vendor and product at a port are a Maestro's."""
        return usb_product(port) in _USB_PRODUCTS

    def port_release(self, port: str, wiring: Wiring | None) -> Callable[[], PortRelease]:
        """Return a function that opens the port and returns a `MaestroRelease`, to end all pulses.

        wiring: None: the model is unknown, and commands have neither device number nor CRC. The
        function raises PortError.
        """
        from firmware_bridge.maestro.release import MaestroRelease

        opener = _opener(port)
        settings = MaestroSettings(model="mini24") if wiring is None else wiring.settings
        return lambda: MaestroRelease(opener(), port, settings, knows=wiring is not None)

    def examine(self, wiring: Wiring) -> Iterator[Finding]:
        """Yield findings about the controller and its pulses, since hobby servos do not answer.

        Opens the port, and only reads. If `serial_timeout_s` is set, waits 1.2 times as long
        without a command: the Maestro must then report a timeout, at which it ends its pulses.
        Raises PortError unless a Maestro answers.
        """
        from firmware_bridge.maestro.controller import Maestro, check_channels
        from firmware_bridge.maestro.protocol import TIMEOUT_ERROR, describe_errors

        settings: MaestroSettings = wiring.settings
        check_channels(wiring)
        transport = _opener(str(settings.port))()
        try:
            maestro = Maestro(transport, settings)
            earlier = maestro.read_errors() or 0  # `check` clears them
            maestro.check(str(settings.port))
            yield Finding(Severity.GOOD, f"a Maestro answers at {settings.port}")
            for joint in wiring.joints:
                pulse_us = maestro.position_us(joint.servo_id)
                what = f"servo {joint.name!r} (channel {joint.servo_id})"
                if math.isnan(pulse_us):
                    what += ": no answer to what it is sent"
                    yield Finding(Severity.BAD, what, "check the USB cable; run it again")
                    continue
                sends = f"is sent {pulse_us:.0f} us" if pulse_us else "gets no pulses"
                yield Finding(Severity.GOOD, f"{what} {sends}")
            for words in describe_errors((earlier | maestro.errors) & ~TIMEOUT_ERROR):
                remedy = "asked for and cleared; run it again"
                yield Finding(Severity.WARNING, f"it tells of a {words}", remedy)
            timeout_s = settings.serial_timeout_s
            if not timeout_s:
                yield Finding(Severity.WARNING, _DEAD_COMPUTER, _SET_TIMEOUT)
                return
            clock = transport.clock
            clock.sleep_until(clock.now() + 1.2 * timeout_s)
            if (maestro.read_errors() or 0) & TIMEOUT_ERROR:
                yield Finding(Severity.GOOD, f"it stops its pulses by itself after {timeout_s:g} s")
            else:
                what = f"serial_timeout_s is {timeout_s:g}, but {_DEAD_COMPUTER}"
                yield Finding(Severity.BAD, what, _SET_TIMEOUT)
        finally:
            transport.close()


def _opener(port: str) -> Callable[[], Any]:
    from firmware_bridge.serial_servos.serial_transport import SameAdapter

    return SameAdapter(port, BAUD_RATE)


MAESTRO: Final = MaestroKind()
