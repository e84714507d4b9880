"""The kind of servo bus `pca9685`: hobby servos at a PCA9685."""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

from firmware_bridge.bus_kinds import BusKind, Finding, PortRelease, Wiring
from firmware_bridge.capabilities import SOFT_START_S, BusCapabilities
from firmware_bridge.errors import PortError, ServoError
from firmware_bridge.pca9685.registers import N_CHANNELS
from firmware_bridge.pca9685.settings import Pca9685Servo, Pca9685Settings, check_pulses
from firmware_bridge.pulse_bus import PULSES_OFF, STAGGER_S

if TYPE_CHECKING:
    from firmware_bridge.bus import ServoBus
    from firmware_bridge.bus_settings import BusSettings
    from firmware_bridge.clock import Clock
    from firmware_bridge.pca9685.controller import Pca9685
    from firmware_bridge.pca9685.i2c import I2cChip
    from firmware_bridge.pca9685.oe_guard import OeGuard

#: The clock assumed for a bus that states none, in bits/s; bits of a byte with its acknowledge.
_STANDARD_HZ: Final = 100_000
_BYTE_BITS: Final = 9
#: The share of a tick's period that the bus may take.
_SHARE: Final = 0.6


class Pca9685Kind(BusKind):
    """The kind of servo bus `pca9685`: what lipservo can do with hobby servos at a PCA9685."""

    name = "pca9685"
    settings = Pca9685Settings
    servo = Pca9685Servo
    board_key = "address"
    usual_board = "0x40"
    simulator_module = "firmware_bridge.pca9685.simulator"

    def capabilities(self, settings: "BusSettings") -> BusCapabilities:
        """Return what the servos can do: they hold while pulses continue, and report nothing."""
        assert isinstance(settings, Pca9685Settings)
        return BusCapabilities(
            hold=True,
            soft_start_s=SOFT_START_S,
            stagger_s=STAGGER_S,
            in_memory=settings.port is None,
            watchdog=_has_guard(settings),
            pulse_rate_hz=settings.frequency_hz,
            released_words=PULSES_OFF,
        )

    def open(self, wiring: Wiring, clock: "Clock", *, strict: bool = True) -> "ServoBus":  # noqa: ARG002 - no servo can be asked whether it is there
        """Return the face's bus, unopened: over I2C, or simulated in memory when no port is set.

        strict: without effect, since a missing hobby servo cannot be detected.
        """
        from firmware_bridge.pca9685.i2c import is_terminal
        from firmware_bridge.pca9685.oe_guard import OeGuard
        from firmware_bridge.pulse_bus import KeptPulses, PulseBus
        from firmware_bridge.simulator.bus import SimulatedBus

        settings, can = wiring.settings, self.capabilities(wiring.settings)
        if settings.port is None:
            return SimulatedBus(wiring.joints, clock, capabilities=can)
        pin, kept = (settings.gpio_chip, settings.oe_gpio), KeptPulses(wiring.kept)
        guard = OeGuard(*pin, clock) if _has_guard(settings) else None
        controller = controller_of(wiring, opener_of(wiring), clock, guard)
        # may_jump: servos may start without a known position. Simulated ones always may.
        may_jump = wiring.may_jump or is_terminal(settings.port)
        return PulseBus(wiring.servos, controller, clock, can, kept, may_jump=may_jump)

    def slowness(self, wiring: Wiring, rate_hz: float) -> str | None:
        """Return why the I2C bus is too slow for `rate_hz` ticks a second; None: it is fast enough.

        The text has the remedy. Computed from the bytes of a tick, which may take 60 % of its
        period, and the bus clock that the device tree states.
        """
        bits_s = _bits_s(wiring.settings.port or "")
        # Four bytes a servo; eight for addresses, a register's number and the read of MODE1.
        needed_s = (4 * len(wiring.servos) + 8) * _BYTE_BITS / bits_s
        if needed_s <= _SHARE / rate_hz:
            return None
        return (
            f"{len(wiring.servos)} servos take {needed_s * 1e3:.1f} ms of an I2C bus of "
            f"{bits_s / 1e3:g} kHz, too long at {rate_hz:g} Hz; set it to 400 kHz (Raspberry Pi: "
            "`dtparam=i2c_arm_baudrate=400000`), or lower rate_hz"
        )

    def port_release(self, port: str, wiring: Wiring | None) -> Callable[[], PortRelease]:
        """Return a function that opens the face's board to switch its outputs off.

        Raises PortError if `wiring`, which has the board's address, is None.
        """
        if wiring is None:
            raise PortError(f"{port}: the board's address is not known; give --config FACE.yaml")
        return lambda: BoardRelease(opener_of(wiring)())

    def examine(self, wiring: Wiring) -> Iterator[Finding]:
        """Yield findings on the I2C bus, the chip, its pulses and its OE pin; only reads."""
        from firmware_bridge.pca9685.doctor import examine

        yield from examine(wiring, opener_of(wiring), self.slowness(wiring, wiring.rate_hz))


class BoardRelease:
    """A `PortRelease` that switches off all outputs of a PCA9685; no servo confirms being limp."""

    confirms = False

    def __init__(self, chip: "I2cChip") -> None:
        """Use an open chip. Closes it and raises PortError if it is not a PCA9685."""
        from firmware_bridge.pca9685.controller import check_identity

        self._chip = chip
        try:
            check_identity(chip)
        except PortError:
            chip.close()
            raise

    def tell_all(self, addresses: Sequence[int]) -> None:  # noqa: ARG002 - one byte is for all
        """Switch the pulses of all channels off, whatever `addresses` contains."""
        from firmware_bridge.pca9685.registers import ALL_OFF

        self._chip.write([ALL_OFF])

    def ask(self, address: int) -> str:
        """Return why the servo of channel `address` never counts as limp: it reports nothing."""
        return f"channel {address} cannot say whether its servo holds"

    def find(self, addresses: Sequence[int]) -> Sequence[int]:
        """Switch all pulses off; return `addresses`, or all 16 channels if it is empty.

        Connected servos cannot be detected.
        """
        self.tell_all(addresses)
        return addresses or range(N_CHANNELS)

    def close(self) -> None:
        """Close the bus."""
        self._chip.close()


def opener_of(wiring: Wiring) -> Callable[[], "I2cChip"]:
    """Return a function that opens the PCA9685 of the face in `wiring`, and raises PortError."""
    from firmware_bridge.pca9685.i2c import open_chip

    return partial(open_chip, wiring.settings.port, wiring.settings.address)


def controller_of(
    wiring: Wiring,
    opener: Callable[[], "I2cChip"],
    clock: "Clock",
    guard: "OeGuard | None" = None,
) -> "Pca9685":
    """Return the controller of a face's PCA9685, unopened.

    opener: opens the chip. guard: holds the chip's OE pin; None: nothing holds that pin. Raises
    ServoError where the servos' longest pulse does not fit into the period of the pulses.
    """
    from firmware_bridge.pca9685.controller import Pca9685

    if why := check_pulses(wiring.settings, max(each.max_us for each in wiring.servos)):
        raise ServoError(f"servos: {why}")
    channels = [each.channel for each in wiring.servos]
    return Pca9685(opener, wiring.settings.timing, channels, clock, guard)


def _has_guard(settings: Pca9685Settings) -> bool:
    """Return whether the face is driven with a guard at its OE pin.

    True where `oe_gpio` and a port are set; behind a pseudo-terminal only if `gpio_chip` is a FIFO.
    """
    from firmware_bridge.pca9685.i2c import is_terminal
    from firmware_bridge.pca9685.oe_guard import is_stand_in

    if settings.oe_gpio is None or settings.port is None:
        return False
    return not is_terminal(settings.port) or is_stand_in(settings.gpio_chip)


def _bits_s(port: str) -> int:
    """Return the clock of the I2C bus `port` in bits/s from the device tree, else 100,000."""
    number = Path(port).name.removeprefix("i2c-")
    try:
        cells = Path(f"/sys/class/i2c-adapter/i2c-{number}/of_node/clock-frequency").read_bytes()
    except OSError:
        return _STANDARD_HZ
    return int.from_bytes(cells, "big") or _STANDARD_HZ


PCA9685: Final = Pca9685Kind()
