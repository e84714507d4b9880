"""Registers of a PCA9685, and its pulses in counts, the units of its clock: pure functions.

Sections and tables: https://www.nxp.com/docs/en/data-sheet/PCA9685.pdf, revision 4.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from itertools import groupby
from typing import Final

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.bus import Array

N_CHANNELS: Final = 16
#: Counts of one cycle (7.3.3).
CYCLE: Final = 4096
#: The internal oscillator as the data sheet has it; boards differ by some per cent.
NOMINAL_CLOCK_HZ: Final = 25_000_000
#: From the end of sleep to the first cycle (7.3.1.1).
OSCILLATOR_S: Final = 500e-6
#: Bit 4 of LEDn_ON_H and LEDn_OFF_H: full on, full off; full off wins (7.3.3).
FULL: Final = 0x10
_BYTES: Final = 4


class Register(IntEnum):
    """Addresses of a PCA9685's registers, table 4 of its data sheet."""

    MODE1 = 0x00
    MODE2 = 0x01
    SUBADR1 = 0x02
    ALLCALLADR = 0x05
    LED0_ON_L = 0x06
    LED15_OFF_H = 0x45
    ALL_LED_ON_L = 0xFA
    ALL_LED_OFF_H = 0xFD
    PRE_SCALE = 0xFE
    TEST_MODE = 0xFF


class Mode1(IntFlag):
    """Bits of the PCA9685's register MODE1, table 5 of its data sheet."""

    RESTART = 0x80
    EXTERNAL_CLOCK = 0x40
    AUTO_INCREMENT = 0x20
    SLEEP = 0x10
    SUB1 = 0x08
    SUB2 = 0x04
    SUB3 = 0x02
    ALL_CALL = 0x01


class Mode2(IntFlag):
    """Bits of the PCA9685's register MODE2, table 6 of its data sheet.

    CHANGE_ON_ACK unset: outputs change together, after a STOP.
    """

    INVERT = 0x10
    CHANGE_ON_ACK = 0x08
    TOTEM_POLE = 0x04


#: MODE1 while pulses are made. The chip then answers at its own address alone, not at those that
#: several chips share, such as the all-call address 0x70, at which multiplexers are found.
RUNNING: Final = Mode1.AUTO_INCREMENT
#: SUBADR1..3 and ALLCALLADR after power-up, by which the chip is recognised: it has no id register.
IDENTITY: Final = bytes([0xE2, 0xE4, 0xE8, 0xE0])
#: The message that ends the pulses of all channels: one register byte, so never half done; a chip
#: that sleeps obeys it, too.
ALL_OFF: Final = bytes([Register.ALL_LED_OFF_H, FULL])


def channel_register(channel: int) -> int:
    """Return the address of a channel's first register, LEDn_ON_L; ValueError outside 0..15."""
    if not 0 <= channel < N_CHANNELS:
        raise ValueError(f"channel {channel} is outside 0..{N_CHANNELS - 1}")
    return Register.LED0_ON_L + _BYTES * channel


@dataclass(frozen=True, slots=True)
class Timing:
    """The length of a count, which is the unit of pulses: clock and prescaler of one chip.

    clock_hz: as measured at this chip. prescale: the value of the PRE_SCALE register.
    """

    clock_hz: float
    prescale: int

    @classmethod
    def at(cls, clock_hz: float, frequency_hz: float) -> "Timing":
        """Return the timing nearest to `frequency_hz`, for a chip with clock `clock_hz` (7.3.5).

        Raises ValueError where no value of the prescaler gives that frequency.
        """
        prescale = int(clock_hz / (CYCLE * frequency_hz) + 0.5) - 1
        if not 3 <= prescale <= 255:
            raise ValueError(
                f"pulses at {frequency_hz:g} Hz are impossible: a clock of {clock_hz:g} Hz makes "
                f"{clock_hz / CYCLE / 256:.0f} to {clock_hz / CYCLE / 4:.0f} Hz"
            )
        return cls(clock_hz, prescale)

    @property
    def count_us(self) -> float:
        """The length of one count in us: the step in which pulses can be set."""
        return (self.prescale + 1) / self.clock_hz * 1e6

    @property
    def period_us(self) -> float:
        """The time in us from the start of one pulse to the start of the next."""
        return CYCLE * self.count_us

    @property
    def frequency_hz(self) -> float:
        """The frequency of the pulses in Hz, as the whole-numbered prescaler makes it."""
        return 1e6 / self.period_us

    def counts(self, pulses_us: Array) -> NDArray[np.int64]:
        """Return each pulse width as the nearest whole number of counts.

        Parameters
        ----------
        pulses_us : Array
            (n_servos,) us.

        Returns
        -------
        NDArray[np.int64]
            (n_servos,); 0: no pulse.
        """
        return (pulses_us / self.count_us + 0.5).astype(np.int64)

    def resolution_deg(self, us_per_deg: float) -> float:
        """Return a servo's smallest step in degrees: one count, by its `us_per_deg`."""
        return self.count_us / abs(us_per_deg)


class PulseMessages:
    """The I2C messages of a tick: four bytes a channel, neighbouring channels in one message.

    Every channel's pulse begins a sixteenth of the cycle after that of the channel before, so that
    servos do not all draw their current at once; a pulse may continue into the next cycle.
    """

    def __init__(self, channels: Sequence[int]) -> None:
        """Lay out messages for `channels`: each servo's, in the order of the pulses; none twice.

        `_runs`: a message for each run of neighbouring channels: first register, then four bytes a
        channel. `_places`: for each servo, the count at which its pulse begins, its message, and
        the index in there of its two OFF bytes.
        """
        self._runs = []
        self._places = [(0, bytearray(), 0)] * len(channels)
        order = sorted(range(len(channels)), key=lambda index: channels[index])
        for _, run in groupby(enumerate(order), key=lambda each: channels[each[1]] - each[0]):
            servos = [index for _, index in run]
            message = bytearray([channel_register(channels[servos[0]])])
            for index in servos:
                on = channels[index] * (CYCLE // N_CHANNELS)
                message += bytes([on & 0xFF, on >> 8, 0, FULL])
                self._places[index] = (on, message, len(message) - 2)
            self._runs.append(message)

    def of(self, counts: NDArray[np.int64]) -> list[bytearray]:
        """Return one I2C message for each run of neighbouring channels, for one transfer.

        Parameters
        ----------
        counts : NDArray[np.int64]
            (n_servos,) pulse widths; a cycle has 4096 counts, 0: full off.

        Returns
        -------
        list[bytearray]
            The messages; their memory is used again at the next call.
        """
        # A pulse ends `count` counts after it begins. For sixteen channels a loop beats NumPy.
        for count, (on, message, at) in zip(counts.tolist(), self._places, strict=True):
            off = (on + count) & (CYCLE - 1)
            message[at] = off & 0xFF
            message[at + 1] = off >> 8 if count else FULL
        return self._runs


def counts_of(registers: bytes) -> int:
    """Return the pulse width that a channel's four register bytes make, in counts; 0: no pulse."""
    on = registers[0] | (registers[1] & 0x0F) << 8
    off = registers[2] | (registers[3] & 0x0F) << 8
    if registers[3] & FULL:
        return 0
    return CYCLE if registers[1] & FULL else (off - on) % CYCLE
