"""Simulate a PCA9685 with hobby servos: obeys I2C messages to the byte, and logs every pulse.

Modelled by the data sheet: addresses, auto-increment and its roll-overs, sleep and restart, the
prescaler, power-up values, registers that count from the next cycle on, the OE pin. Not modelled:
time on the wire, outputs inverted or changed on ACK, open-drain outputs.
"""

import contextlib
import errno
import os
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal, get_args

import numpy as np

from firmware_bridge.bus import Array, ServoBus
from firmware_bridge.bus_kinds import Wiring
from firmware_bridge.clock import Clock, ManualClock
from firmware_bridge.errors import PortError, ServoError
from firmware_bridge.pca9685.i2c import ANSWER, COUNT, MESSAGE, READ, I2cChip, Message
from firmware_bridge.pca9685.kind import PCA9685, controller_of
from firmware_bridge.pca9685.oe_guard import is_stand_in
from firmware_bridge.pca9685.registers import (
    CYCLE,
    FULL,
    IDENTITY,
    N_CHANNELS,
    NOMINAL_CLOCK_HZ,
    OSCILLATOR_S,
    Mode1,
    Mode2,
    Register,
    counts_of,
)
from firmware_bridge.pulse_bus import PulseBus
from firmware_bridge.simulation_request import (
    DueFaults,
    SimulationRequest,
    TimedFault,
    parse_faults,
)
from firmware_bridge.simulator.ports import PtyHost, WatchedServos

#: Address and data of the message that resets every PCA9685 of a bus.
_SOFTWARE_RESET: Final = (0x00, bytes([0x06]))
#: With auto-increment, register 0 follows on these.
_LAST: Final = (Register.LED15_OFF_H, Register.PRE_SCALE)
#: A hobby servo obeys pulses of these widths and ignores others.
_SHORTEST_US, _LONGEST_US = 400.0, 2600.0


class ChipFault(TimedFault):
    """One fault of a simulated PCA9685, of a `kind`, as a fault script lists it.

    nack: no chip acknowledges; stuck: a line is held low; unplug: the computer has no such bus: for
    lasts_s. cut: of the next transfer two bytes arrive; brown-out: as after power-up.
    """

    kind: Literal["nack", "stuck", "cut", "brown-out", "unplug"]

    def is_on(self, now_s: float) -> bool:
        """Return whether the fault is in effect at the time `now_s`."""
        since_s = now_s - self.at_s
        return (
            since_s >= 0.0 and (since_s % self.every_s if self.every_s else since_s) < self.lasts_s
        )


#: Kinds of faults.
FAULTS: Final = get_args(ChipFault.model_fields["kind"].annotation)


def read_faults(text: str | None) -> Sequence[ChipFault]:
    """Return the faults in the YAML `text`, none for None. Raises ValueError for bad YAML."""
    return parse_faults(text, ChipFault)


@dataclass(frozen=True, slots=True)
class Pulse:
    """One pulse of a channel. is_cut: it ended early, and `width_us` is its shortened width."""

    channel: int
    start_s: float
    width_us: float
    is_cut: bool = False


@dataclass(slots=True)
class HobbyServo:
    """A simulated hobby servo's shaft, which runs to the angle of its last pulse at constant speed.

    us_per_deg, neutral_us: as in a face's YAML. Without pulses the shaft stays: a digital servo
    holds it, an analogue one is stiff by its gears alone.
    """

    us_per_deg: float
    neutral_us: float
    top_speed_deg_s: float = 600.0
    place_deg: float = 0.0
    goal_deg: float | None = None
    _at_s: float = 0.0

    def pulse(self, pulse: Pulse) -> None:
        """Set the goal angle from a pulse; ignore a width outside 400..2600 us."""
        self.advance(pulse.start_s)
        if _SHORTEST_US <= pulse.width_us <= _LONGEST_US:
            self.goal_deg = (pulse.width_us - self.neutral_us) / self.us_per_deg

    def advance(self, time_s: float) -> float:
        """Move towards the goal until `time_s`, and return the shaft's angle in degrees."""
        reach_deg = max(0.0, time_s - self._at_s) * self.top_speed_deg_s
        self._at_s = max(self._at_s, time_s)
        if self.goal_deg is not None:
            left_deg = self.goal_deg - self.place_deg
            self.place_deg += min(max(left_deg, -reach_deg), reach_deg)
        return self.place_deg


class SimulatedPca9685:
    """A simulated PCA9685, from power-up on. Callers pass the time in s, which never goes back.

    Faults come from a script, or are set at any time: `nacks` is the number of coming transfers
    that are not acknowledged, `cut_after` the number of bytes of the next write that arrive;
    `brown_out` is called.
    """

    def __init__(
        self,
        address: int = 0x40,
        *,
        clock_hz: float = NOMINAL_CLOCK_HZ,
        servos: Mapping[int, HobbyServo] | None = None,
        faults: Sequence[ChipFault] = (),
        on_pulse: Callable[[Pulse], None] | None = None,
        oe_is_high: Callable[[], bool] = lambda: False,
    ) -> None:
        """Start as after power-up.

        servos: by channel. faults: of the script. on_pulse: called with every pulse that has ended,
        which `pulses` logs, too. oe_is_high: returns whether the OE pin is high, which blocks all
        pulses. `to_others` logs messages to other addresses.
        """
        self.address, self._clock_hz = address, clock_hz
        self.servos = dict(servos or {})
        self.pulses: deque[Pulse] = deque(maxlen=200_000)
        self.to_others: deque[tuple[int, bytes]] = deque(maxlen=200_000)
        self.nacks, self.cut_after = 0, -1
        self.registers = bytearray(256)
        self._on_pulse = on_pulse or (lambda _pulse: None)
        self._oe_is_high, self._is_blocked = oe_is_high, oe_is_high()
        self._faults, self._coming = faults, DueFaults(faults)
        self._now_s = 0.0
        self._cycle_s: float | None = None  # when the next cycle begins; None: asleep
        self._awaits_restart = False
        self._under_way: dict[int, Pulse] = {}
        self._reset()

    @property
    def plugged(self) -> bool:
        """Whether the computer has the I2C bus: False during an `unplug` fault."""
        return not self._suffers("unplug")

    @property
    def is_reachable(self) -> bool:
        """Whether no `unplug`, `stuck` or `nack` fault of the script blocks a transfer now."""
        return self.plugged and not self._suffers("stuck") and not self._suffers("nack")

    def transfer(self, messages: Sequence[Message], time_s: float) -> tuple[int, bytes]:
        """Run an I2C transfer at `time_s`; return its error number (0: none) and the bytes read.

        messages: (address, flags, bytes to write or number of bytes to read); the first byte
        written is the register to begin with. At an error nothing is read, but what was written
        before counts.
        """
        self.advance(time_s)
        if not self.plugged:
            return errno.ENODEV, b""
        if self._suffers("stuck"):
            return errno.ETIMEDOUT, b""
        if self.nacks or self._suffers("nack"):
            self.nacks = max(0, self.nacks - 1)
            return errno.EREMOTEIO, b""
        found, pointer = b"", 0
        for address, flags, data in messages:
            if (address, data) == _SOFTWARE_RESET:
                self._reset()
            elif not self._answers(address):
                self.to_others.append((address, data if isinstance(data, bytes) else b""))
                return errno.EREMOTEIO, b""
            elif flags & READ or isinstance(data, int):
                for _ in range(data if isinstance(data, int) else 0):
                    found += bytes([self._read(pointer)])
                    pointer = self._next(pointer)
            elif data:
                # The fault `cut`: only so many bytes of the message arrive; -1: all.
                pointer, cut = data[0], self.cut_after
                self.cut_after = -1
                for value in data[1 : cut if cut >= 0 else None]:
                    self._write(pointer, value)
                    pointer = self._next(pointer)
                if cut >= 0:
                    return errno.EREMOTEIO, b""
        return 0, found

    def advance(self, time_s: float) -> None:
        """Simulate faults, the OE pin and the pulses of every cycle that begins by `time_s`."""
        self._now_s = max(self._now_s, time_s)
        for _, fault in self._coming.take(self._now_s):
            if fault.kind == "brown-out":
                self.brown_out()
            elif fault.kind == "cut":
                self.cut_after = 2
        while self._cycle_s is not None and self._cycle_s <= self._now_s:
            self._begin_cycle(self._cycle_s)
            self._cycle_s += CYCLE * self.count_us * 1e-6
        self._is_blocked = self._oe_is_high()
        if self._is_blocked:
            self._cut()

    def _suffers(self, kind: str) -> bool:
        return any(each.kind == kind and each.is_on(self._now_s) for each in self._faults)

    def brown_out(self) -> None:
        """Simulate a failure of the supply: cut the present pulses, and reset all registers."""
        self._cut()
        self._reset()

    @property
    def count_us(self) -> float:
        """The length of one count in us, by the prescaler and the chip's clock."""
        return (self.registers[Register.PRE_SCALE] + 1) / self._clock_hz * 1e6

    def places_deg(self, time_s: float) -> dict[int, float]:
        """Return the angles of the servos' shafts at `time_s` in degrees, by channel."""
        self.advance(time_s)
        for pulse in self._under_way.values():
            self._order(pulse)
        return {channel: servo.advance(time_s) for channel, servo in self.servos.items()}

    def log(self) -> list[Pulse]:
        """Return all logged pulses, oldest first; those still under way have their full width."""
        return [*self.pulses, *sorted(self._under_way.values(), key=lambda each: each.start_s)]

    def _answers(self, address: int) -> bool:
        mode, registers = self.registers[Register.MODE1], self.registers
        shared = ((Mode1.SUB1, 2), (Mode1.SUB2, 3), (Mode1.SUB3, 4), (Mode1.ALL_CALL, 5))
        also = [registers[register] >> 1 for bit, register in shared if mode & bit]
        return address == self.address or address in also

    def _reset(self) -> None:
        """Set all registers as after power-up: asleep, all channels off."""
        self.registers[:] = bytes(256)
        self.registers[Register.MODE1] = Mode1.SLEEP | Mode1.ALL_CALL
        self.registers[Register.MODE2] = Mode2.TOTEM_POLE
        self.registers[Register.SUBADR1 : Register.ALLCALLADR + 1] = IDENTITY
        self.registers[Register.PRE_SCALE] = 0x1E
        for channel in range(N_CHANNELS):
            self.registers[Register.LED0_ON_L + 4 * channel + 3] = FULL
        self._cycle_s, self._awaits_restart = None, False

    def _read(self, register: int) -> int:
        is_all = Register.ALL_LED_ON_L <= register <= Register.ALL_LED_OFF_H
        return 0 if is_all else self.registers[register]

    def _next(self, register: int) -> int:
        if not self.registers[Register.MODE1] & Mode1.AUTO_INCREMENT:
            return register
        return 0 if register in _LAST else (register + 1) & 0xFF

    def _write(self, register: int, value: int) -> None:
        """Write one byte to a register, as the chip allows: the prescaler only while asleep."""
        if register == Register.MODE1:
            self._write_mode(value)
        elif register == Register.PRE_SCALE:
            if self.registers[Register.MODE1] & Mode1.SLEEP:
                self.registers[register] = max(3, value)
        elif Register.LED0_ON_L <= register <= Register.LED15_OFF_H:
            self._write_channel(register, value)
        elif Register.ALL_LED_ON_L <= register <= Register.ALL_LED_OFF_H:
            offset = register - Register.ALL_LED_ON_L
            for channel in range(N_CHANNELS):
                self._write_channel(Register.LED0_ON_L + 4 * channel + offset, value)
        elif register <= Register.ALLCALLADR:  # MODE2 has five bits; addresses do not use bit 0
            self.registers[register] = value & (0x1F if register == Register.MODE2 else 0xFE)

    def _write_mode(self, value: int) -> None:
        """Write MODE1: sleep cuts all pulses; awake, cycles begin after the oscillator's start.

        A chip that went to sleep while it made pulses makes none until the bit RESTART, or a
        channel, is written.
        """
        was = Mode1(self.registers[Register.MODE1])
        mode = Mode1(value & ~Mode1.RESTART & ~Mode1.EXTERNAL_CLOCK) | was & Mode1.EXTERNAL_CLOCK
        if mode & Mode1.SLEEP and not was & Mode1.SLEEP:
            has_pulses = any(self._counts(channel) for channel in range(N_CHANNELS))
            self._awaits_restart = self._awaits_restart or has_pulses
            self._cut()
            self._cycle_s = None
        elif was & Mode1.SLEEP and not mode & Mode1.SLEEP:
            self._cycle_s = self._now_s + OSCILLATOR_S
        elif value & Mode1.RESTART:
            self._awaits_restart = False
        restart = Mode1.RESTART if self._awaits_restart else Mode1(0)
        self.registers[Register.MODE1] = mode | restart

    def _write_channel(self, register: int, value: int) -> None:
        is_high = (register - Register.LED0_ON_L) & 1
        self.registers[register] = value & 0x1F if is_high else value
        if not self.registers[Register.MODE1] & Mode1.SLEEP:  # as 7.3.1.1: a write restarts, too
            self._awaits_restart = False
            self.registers[Register.MODE1] &= ~Mode1.RESTART & 0xFF

    def _counts(self, channel: int) -> int:
        first = Register.LED0_ON_L + 4 * channel
        return counts_of(bytes(self.registers[first : first + 4]))

    def _begin_cycle(self, time_s: float) -> None:
        """Log the pulses of the last cycle, and start those of the cycle that begins at `time_s`.

        None is started while the OE pin is high, or a restart is awaited.
        """
        for pulse in self._under_way.values():
            self._order(pulse)
            self._note(pulse)
        self._under_way.clear()
        if self._awaits_restart or self._is_blocked:
            return
        for channel in range(N_CHANNELS):
            if counts := self._counts(channel):
                # LEDn_ON: how many counts after the cycle's start the pulse begins
                first = Register.LED0_ON_L + 4 * channel
                on = self.registers[first] | (self.registers[first + 1] & 0x0F) << 8
                start_s = time_s + on * self.count_us * 1e-6
                self._under_way[channel] = Pulse(channel, start_s, counts * self.count_us)

    def _order(self, pulse: Pulse) -> None:
        if (servo := self.servos.get(pulse.channel)) is not None and pulse.start_s <= self._now_s:
            servo.pulse(pulse)

    def _cut(self) -> None:
        """End the pulses that are under way now, and log the shortened ones."""
        for channel, pulse in list(self._under_way.items()):
            if pulse.start_s + pulse.width_us * 1e-6 <= self._now_s:
                continue
            del self._under_way[channel]
            # A pulse that would begin later in the cycle is dropped.
            if pulse.start_s < self._now_s:
                width_us = (self._now_s - pulse.start_s) * 1e6
                self._note(replace(pulse, width_us=width_us, is_cut=True))

    def _note(self, pulse: Pulse) -> None:
        self.pulses.append(pulse)
        self._on_pulse(pulse)


class MemoryTransfers:
    """`Transfers` to a simulated PCA9685 in this process."""

    def __init__(self, chip: SimulatedPca9685, clock: Clock) -> None:
        self._chip, self._clock = chip, clock

    def transfer(self, messages: Sequence[Message]) -> bytes:
        """Run messages as one transfer; return all bytes read, joined. Raises OSError."""
        number, found = self._chip.transfer(messages, self._clock.now())
        if number:
            raise OSError(number, "simulated")
        return found

    def close(self) -> None:
        """Do nothing: a chip in memory needs no closing."""


class TerminalChip:
    """A simulated PCA9685 as the device of a `PtyHost`: each transfer is a frame of bytes."""

    def __init__(self, chip: SimulatedPca9685) -> None:
        self.chip = chip
        self._received = self._answers = b""
        self._received_s = 0.0

    @property
    def plugged(self) -> bool:
        """Whether the pseudo-terminal exists: False during an `unplug` fault."""
        return self.chip.plugged

    @property
    def next_delivery_s(self) -> float:
        """The time in s at which an answer is due: 0 (at once) if there is one, else infinity."""
        return 0.0 if self._answers else float("inf")

    def advance(self, time_s: float) -> None:
        """Simulate the chip and its servos up to `time_s`."""
        self.chip.advance(time_s)

    def receive(self, data: bytes, time_s: float, _baud_rate: int) -> None:
        """Run the transfers in the frames in `data`; an incomplete frame is kept for .5 s."""
        if time_s - self._received_s > 0.5:
            self._received = b""  # half a frame, whose sender has died
        self._received += data
        self._received_s = time_s
        while (taken := _parse(self._received)) is not None:
            messages, self._received = taken
            number, found = self.chip.transfer(messages, time_s)
            self._answers += ANSWER.pack(number, len(found)) + found

    def deliver(self, _time_s: float) -> bytes:
        """Return and remove the answers to all transfers so far; b"": there are none."""
        answers, self._answers = self._answers, b""
        return answers


def _parse(data: bytes) -> tuple[list[Message], bytes] | None:
    """Return the messages of the first frame in `data` and the bytes after it; None: incomplete.

    A frame: the number of messages, then for each its address, flags and length, and if it is a
    write so many bytes.
    """
    if not data:
        return None
    messages: list[Message] = []
    at = COUNT.size
    for _ in range(data[0]):
        if len(data) < at + MESSAGE.size:
            return None
        address, flags, length = MESSAGE.unpack_from(data, at)
        at += MESSAGE.size
        if flags & READ:
            messages.append((address, flags, length))
            continue
        if len(data) < at + length:
            return None
        messages.append((address, flags, data[at : at + length]))
        at += length
    return messages, data[at:]


class PinFifo:
    """A FIFO that an OE guard drives in place of a GPIO line, with the board's pull-up.

    While the guard's end is closed, as after its death, the pin counts as high.
    """

    def __init__(self, path: Path) -> None:
        """Make the FIFO if needed, and open it. Raises PortError where that fails."""
        try:
            if not is_stand_in(str(path)):
                os.mkfifo(path, 0o600)
            self._fd = os.open(path, os.O_RDONLY | os.O_NONBLOCK)
        except OSError as error:
            raise PortError(f"gpio_chip {path}: no FIFO can be made: {error.strerror}") from error
        self._is_high = True

    def is_high(self) -> bool:
        """Return whether the pin is high, by the last byte in the FIFO; True without a guard."""
        with contextlib.suppress(BlockingIOError):
            self._is_high = os.read(self._fd, 4096)[-1:] != b"0"
        return self._is_high


def chip_for(wiring: Wiring, **options: Any) -> SimulatedPca9685:
    """Return the simulated PCA9685 of the face in `wiring`, with its servos at neutral.

    options: as for `SimulatedPca9685`.
    """
    servos = {each.channel: HobbyServo(each.us_per_deg, each.neutral_us) for each in wiring.servos}
    address, clock_hz = wiring.settings.address, wiring.settings.clock_hz
    return SimulatedPca9685(address, clock_hz=clock_hz, servos=servos, **options)


def watched_servos(wiring: Wiring, **options: Any) -> WatchedServos:
    """Return the servos of `wiring` simulated in memory: bus, clock, chip, and the shafts' angles.

    For tests, which move the clock by hand; servos may start without a known position. options: as
    for `SimulatedPca9685`.
    """
    chip, clock = chip_for(wiring, **options), ManualClock()
    opener = partial(I2cChip, MemoryTransfers(chip, clock), chip.address, "simulated PCA9685")
    controller, can = controller_of(wiring, opener, clock), PCA9685.capabilities(wiring.settings)
    bus = PulseBus(wiring.servos, controller, clock, can, may_jump=True)

    def shafts_deg() -> Array:
        places = chip.places_deg(clock.now())
        return np.array([places[each.channel] for each in wiring.servos])

    return WatchedServos(bus, clock, chip, shafts_deg, lambda: chip.is_reachable)


def simulated_wire(wiring: Wiring) -> tuple[ServoBus, ManualClock]:
    """Return the bus of a face's servos simulated in memory, and the clock that moves them."""
    watched = watched_servos(wiring)
    return watched.bus, watched.clock


def serve(wiring: Wiring | None, link: Path | None, request: SimulationRequest) -> PtyHost:
    """Return a host that serves the simulated PCA9685 of a face at a pseudo-terminal.

    link: path of a symbolic link to the terminal. request.log: a file that gets every pulse as a
    line of JSON: start in seconds of the simulator, channel, width in us. Raises ServoError if
    `wiring` is None or the log cannot be written, ValueError for a bad script, and PortError where
    no terminal, link or FIFO can be made.
    """
    if wiring is None:
        raise ServoError("a simulated PCA9685 needs --config FACE.yaml, a face with a PCA9685")
    script, settings = read_faults(request.faults), wiring.settings
    write = request.row_log()

    def on_pulse(pulse: Pulse) -> None:
        write((round(pulse.start_s, 6), pulse.channel, round(pulse.width_us, 2)))

    # A GPIO chip of this computer is never used: then no OE pin is simulated.
    has_pin = settings.oe_gpio is not None and not settings.gpio_chip.startswith("/dev/")
    oe = {"oe_is_high": PinFifo(Path(settings.gpio_chip)).is_high} if has_pin else {}
    return PtyHost(TerminalChip(chip_for(wiring, faults=script, on_pulse=on_pulse, **oe)), link)
