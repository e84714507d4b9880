"""A PCA9685 on I2C as the `PulseController` of a face's hobby servos."""

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

from firmware_bridge.bus import Array, any_set
from firmware_bridge.clock import Clock
from firmware_bridge.errors import BusError, PortError, ServoError
from firmware_bridge.pca9685.i2c import I2cChip
from firmware_bridge.pca9685.oe_guard import OeGuard
from firmware_bridge.pca9685.registers import (
    ALL_OFF,
    IDENTITY,
    OSCILLATOR_S,
    RUNNING,
    Mode1,
    Mode2,
    PulseMessages,
    Register,
    Timing,
    channel_register,
    counts_of,
)

_MODE2: Final = Mode2.TOTEM_POLE
#: The remark about a board whose OE pin no guard holds.
NO_GUARD: Final = (
    "nothing holds the OE pin of the board: when the computer dies, its pulses go on, and servos "
    "hold and pull as before; the switch of the servos' supply is what stops them"
)


class Pca9685:
    """One PCA9685, a chip that makes pulses, as `PulseController`; addresses no other I2C chip."""

    def __init__(
        self,
        open_chip: Callable[[], I2cChip],
        timing: Timing,
        channels: Sequence[int],
        clock: Clock,
        guard: OeGuard | None = None,
    ) -> None:
        """Prepare a controller; `open` connects it.

        open_chip: opens the chip's I2C bus. timing: clock and prescaler of the chip. channels: the
        channel of each servo. guard: holds the OE pin; None: nothing holds it.
        """
        self._open_chip, self._timing, self._clock = open_chip, timing, clock
        self._channels, self._guard = tuple(channels), guard
        self._messages = PulseMessages(channels)
        self._chip: I2cChip | None = None
        self._is_set_up = False

    def open(self) -> None:
        """Open the bus, check that a PCA9685 answers, and start the guard of the OE pin.

        Raises PortError where no PCA9685 answers, or the guard cannot start. Only reads from the
        chip.
        """
        self._give_back()
        self._chip = chip = self._open_chip()
        self._is_set_up = False
        try:
            check_identity(chip)
            if self._guard is not None:
                self._guard.start()
        except PortError:
            self._give_back()
            raise

    def close(self) -> None:
        """Close the bus and the guard; without a guard the chip continues to send its pulses.

        The guard holds the OE pin high from then on unless the chip says that it makes no pulse.
        """
        guard = self._guard
        if guard is not None:
            with contextlib.suppress(BusError):
                guard.beat(passes=False, is_off=False)
                if not any(self.sending(index) for index in range(len(self._channels))):
                    guard.beat(passes=False)
            guard.close()
        self._give_back()

    def send(self, pulses_us: Array) -> bool:
        """Send every servo its pulse in one I2C transfer; all 0: switch the whole board off.

        The transfer also reads whether the chip is still set up: after a failure of its supply the
        chip is as at power-up. Raises PortError, and ServoError when the guard is dead or hangs.

        Parameters
        ----------
        pulses_us : Array
            (n_servos,) us; 0: no pulse.

        Returns
        -------
        bool
            False: no pulse is made, since the chip has lost its setup, or the guard's last
            heartbeat is so old that the guard may have blocked pulses.
        """
        counts, guard = self._timing.counts(pulses_us), self._guard
        if not any_set(counts):
            self._switch_off()
            return True
        if not self._is_set_up and not self._set_up():
            return False
        mode = self._opened.exchange(self._messages.of(counts), Register.MODE1)[0]
        if mode != RUNNING:
            self._is_set_up = False
            return False
        if guard is not None:
            self._beat(guard, passes=True)
            if not guard.passes:
                self._switch_off()
                return False
        return True

    def sending(self, index: int) -> float:
        """Return the pulse in us that the channel of servo `index` makes, read from its registers.

        0: none, also while the chip sleeps. The guard of the OE pin, if any, gets its last
        heartbeat again, or one that blocks after a lapse. Raises PortError, and ServoError when the
        guard is dead or hangs.
        """
        chip, channel = self._opened, self._channels[index]
        if self._guard is not None:
            self._beat(self._guard, passes=self._guard.passes)
        if self._is_set_up and chip.read(Register.MODE1)[0] == RUNNING:
            return counts_of(chip.read(channel_register(channel), 4)) * self._timing.count_us
        return read_pulse_us(chip, channel, self._timing)

    def remarks(self) -> Sequence[str]:
        """Return remarks for the log: a warning where no guard holds the OE pin, else none."""
        return [] if self._guard is not None else [NO_GUARD]

    @property
    def is_blocked(self) -> bool:
        """Whether the guard blocks all pulses, whatever `sending` returns."""
        return self._guard is not None and not self._guard.passes

    @property
    def _opened(self) -> I2cChip:
        if self._chip is None:
            raise PortError("the I2C bus of the PCA9685 is not open")
        return self._chip

    def _give_back(self) -> None:
        if self._chip is not None:
            self._chip.close()
            self._chip = None

    def _switch_off(self) -> None:
        with contextlib.suppress(ServoError):  # the next heartbeat raises it again
            if self._guard is not None:
                self._guard.beat(passes=False, is_off=False)
        self._opened.write([ALL_OFF])
        with contextlib.suppress(ServoError):
            if self._guard is not None:
                self._guard.beat(passes=False)

    def _beat(self, guard: OeGuard, *, passes: bool) -> None:
        """Send the guard a heartbeat that lets pulses through (`passes`) or blocks them.

        Pulses that it may have blocked since the last one stay blocked, as all would come back at
        once. Raises ServoError, after switching all pulses off, when the guard is dead or hangs: if
        this program died then, nothing would end the pulses.
        """
        try:
            has_lapsed = guard.has_lapsed
            guard.beat(passes=passes and not has_lapsed, is_off=not has_lapsed)
        except ServoError:
            self._opened.write([ALL_OFF])
            raise

    def _set_up(self) -> bool:
        """Write prescaler and mode registers unless set already; return whether they read as set.

        Pulses of a chip that is set up already continue. False: the supply failed meanwhile.

        The prescaler can be written only while the chip sleeps and makes no pulse (data sheet,
        7.3.5): all channels go off first, so that no pulse is cut short, and none continues after
        the restart.
        """
        chip, timing = self._opened, self._timing
        if not self._is_as_set_up():
            chip.write([ALL_OFF])
            self._sleep(timing.period_us * 1e-6)  # the present cycle of pulses ends first
            chip.write([bytes([Register.MODE1, RUNNING | Mode1.SLEEP])])
            chip.write([bytes([Register.PRE_SCALE, timing.prescale])])
            chip.write([bytes([Register.MODE2, _MODE2])])
            chip.write([bytes([Register.MODE1, RUNNING])])
            self._sleep(OSCILLATOR_S)
            chip.write([bytes([Register.MODE1, RUNNING | Mode1.RESTART])])
        self._is_set_up = self._is_as_set_up()
        return self._is_set_up

    def _is_as_set_up(self) -> bool:
        registers = (Register.MODE1, Register.MODE2, Register.PRE_SCALE)
        found = [self._opened.read(each)[0] for each in registers]
        return found == [RUNNING, _MODE2, self._timing.prescale]

    def _sleep(self, seconds: float) -> None:
        self._clock.sleep_until(self._clock.now() + seconds)


def check_identity(chip: I2cChip) -> None:
    """Raise PortError unless the chip's identity registers and prescaler are those of a PCA9685.

    Only reads: registers 2 to 5, which have fixed values after power-up, and the prescaler, which
    is never below 3.
    """
    found = b"".join(
        chip.read(register) for register in range(Register.SUBADR1, Register.ALLCALLADR + 1)
    )
    if found != IDENTITY or chip.read(Register.PRE_SCALE)[0] < 3:
        raise PortError(
            f"{chip.name}: no PCA9685 answers there (registers 2 to 5 are {found.hex(' ')}, not "
            f"{IDENTITY.hex(' ')}); an INA219 or HTU21 has the same address: give the board "
            "another by its solder bridges, or switch its supply off and on"
        )


def read_pulse_us(chip: I2cChip, channel: int, timing: Timing) -> float:
    """Return the pulse in us that a channel makes, whoever set the chip up; 0: none, or it sleeps.

    timing: of the chip but for its prescaler, which is read.
    """
    if chip.read(Register.MODE1)[0] & Mode1.SLEEP:
        return 0.0
    # Registers are read one by one, since auto-increment may be off.
    first = channel_register(channel)
    counts = counts_of(b"".join(chip.read(first + n) for n in range(4)))
    return counts * replace(timing, prescale=chip.read(Register.PRE_SCALE)[0]).count_us
