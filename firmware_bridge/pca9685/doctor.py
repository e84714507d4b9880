"""Checks for `lipservo doctor` of a PCA9685's bus, chip, pulses, rate and OE pin, with remedies."""

from collections.abc import Callable, Iterator
from typing import Final

from firmware_bridge.bus_kinds import Finding, Severity, Wiring
from firmware_bridge.errors import PortError
from firmware_bridge.pca9685.controller import NO_GUARD, check_identity, read_pulse_us
from firmware_bridge.pca9685.i2c import I2cChip
from firmware_bridge.pca9685.oe_guard import CONSUMER, user_of
from firmware_bridge.pca9685.registers import NOMINAL_CLOCK_HZ, RUNNING, Mode1, Register
from firmware_bridge.pca9685.settings import Pca9685Settings

_NOT_MEASURED: Final = (
    "clock_hz is that of the data sheet; boards differ by some per cent, pulses with them"
)


def examine(
    wiring: Wiring, opener: Callable[[], I2cChip], slowness: str | None
) -> Iterator[Finding]:
    """Yield findings for `lipservo doctor` on bus, chip, channels, timing, rate and OE pin.

    Only reads, never writes. opener: opens the chip; a PortError of its or of a read becomes the
    last finding. slowness: why the bus is too slow for the face; None: it is fast enough.
    """
    settings: Pca9685Settings = wiring.settings
    try:
        chip = opener()
    except PortError as error:
        yield Finding(Severity.BAD, str(error))
        return
    try:
        yield Finding(Severity.GOOD, f"{settings.port}: an I2C bus, ours alone at this address")
        check_identity(chip)
        yield Finding(Severity.GOOD, f"{chip.name}: a PCA9685")
        yield _mode(chip)
        yield from (_channel(chip, wiring, index) for index in range(len(wiring.servos)))
    except PortError as error:
        yield Finding(Severity.BAD, str(error))
        return
    finally:
        chip.close()
    timing = settings.timing
    yield Finding(
        Severity.GOOD,
        f"pulses {timing.frequency_hz:.1f} times a second, in steps of {timing.count_us:.2f} us",
    )
    if settings.clock_hz == NOMINAL_CLOCK_HZ:
        yield Finding(Severity.WARNING, _NOT_MEASURED, "measure it: docs/hardware.md, bus.clock_hz")
    if slowness:
        yield Finding(Severity.BAD, slowness)
    yield _guard(settings)
    yield Finding(
        Severity.WARNING,
        "whether servos are there, stand where they were sent, or are hot cannot be known",
    )


def _guard(settings: Pca9685Settings) -> Finding:
    """Return the finding on the OE pin: not set, held by another program, or usable."""
    if settings.oe_gpio is None:
        return Finding(Severity.WARNING, NO_GUARD, "put a switch into the servos' supply")
    pin = f"oe_gpio {settings.oe_gpio} of {settings.gpio_chip}"
    try:
        user = user_of(settings.gpio_chip, settings.oe_gpio)
    except PortError as error:
        return Finding(Severity.BAD, f"{pin}: {error}")
    if user and user != CONSUMER:
        return Finding(Severity.BAD, f"{pin}: {user!r} holds it", "end it, or take another pin")
    what = "holds pulses off since a face died" if user else "is free for the guard of the OE pin"
    return Finding(Severity.GOOD, f"{pin} {what}; its pull-up cannot be seen from here")


def _mode(chip: I2cChip) -> Finding:
    """Return the finding on register MODE1: the chip runs, sleeps, or is set up otherwise."""
    mode = Mode1(chip.read(Register.MODE1)[0])
    if mode & ~Mode1.RESTART == RUNNING:
        return Finding(Severity.GOOD, "makes pulses, or is ready to")
    if mode & Mode1.SLEEP:
        return Finding(Severity.GOOD, "asleep, as after power-up: no pulses; a start sets it up")
    return Finding(
        Severity.WARNING, f"set up by another program (MODE1 {mode:#04x})", "a start sets it anew"
    )


def _channel(chip: I2cChip, wiring: Wiring, index: int) -> Finding:
    """Return the finding on a servo's channel: its present pulse, pulse limits and resolution."""
    servo, joint = wiring.servos[index], wiring.joints[index]
    timing = wiring.settings.timing
    pulse_us = read_pulse_us(chip, servo.channel, timing)
    now = f"{pulse_us:.0f} us" if pulse_us else "no pulses"
    step = f"{timing.resolution_deg(servo.us_per_deg):.2f} deg a step"
    return Finding(
        Severity.GOOD,
        f"{joint.name}: channel {servo.channel}, {now}; {servo.min_us:g} to {servo.max_us:g} us, "
        f"{step}",
    )
