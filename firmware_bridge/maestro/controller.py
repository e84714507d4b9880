"""A Maestro on its command port: pulses out in one write, and the pulses and errors it reports."""

from collections.abc import Callable, Sequence
from itertools import groupby
from typing import Final

import numpy as np

from firmware_bridge.bus import Array
from firmware_bridge.bus_kinds import Wiring
from firmware_bridge.errors import PortError, ServoError
from firmware_bridge.maestro.protocol import (
    GET_ERRORS,
    GET_POSITION,
    LARGEST,
    LARGEST_INPUT,
    PROTOCOL_ERROR,
    QUARTERS,
    SET_ACCELERATION,
    SET_SPEED,
    SET_TARGET,
    SET_TARGETS,
    SPEED_UNIT_S,
    WITHOUT_SET_TARGETS,
    command,
    crc7,
    describe_errors,
    split,
)
from firmware_bridge.maestro.settings import MaestroSettings
from firmware_bridge.pulse_servos import PulseScale
from firmware_bridge.transport import Transport

#: How long to wait for an answer. USB answers within two milliseconds, a busy computer later.
_ANSWER_S: Final = 0.02
_TRIES: Final = 3
#: The Maestro's own speed limit is this much above that of the joint.
_SPEED_MARGIN: Final = 1.05
_HIGH_BITS: Final = np.uint16(LARGEST & ~0x7F)


class Maestro:
    """The commands of one Maestro, a USB controller of hobby servos; methods raise PortError."""

    def __init__(self, transport: Transport, settings: MaestroSettings) -> None:
        """Use an open transport, with the device number and CRC of the settings; send nothing."""
        self.transport = transport
        self._device, self.has_crc = settings.device, settings.crc
        #: Bits of `protocol.ERRORS` that the Maestro has reported so far.
        self.errors = 0

    def tell(self, *commands: tuple[int, Sequence[int]]) -> None:
        """Send commands, each (code, data bytes), in one write; read no answer."""
        self.transport.write(b"".join(self.packet(*each) for each in commands))

    def packet(self, code: int, data: Sequence[int] = ()) -> bytes:
        """Return one command as bytes, with this Maestro's device number and CRC if set."""
        return command(code, data, device=self._device, crc=self.has_crc)

    def position_us(self, channel: int) -> float:
        """Read the pulse of a channel, us; 0: none, also of an input; NaN: no answer.

        Stores the Maestro's errors.
        """
        answer = self._ask(4, (GET_POSITION, (channel,)), (GET_ERRORS, ()))
        if answer is None:
            return float("nan")
        self.errors |= int.from_bytes(answer[2:], "little")
        quarters = int.from_bytes(answer[:2], "little")
        return quarters / QUARTERS if quarters > LARGEST_INPUT else 0.0

    def read_errors(self) -> int | None:
        """Read and clear the bits of `protocol.ERRORS`; None: no answer."""
        answer = self._ask(2, (GET_ERRORS, ()))
        return None if answer is None else int.from_bytes(answer, "little")

    def check(self, port: str) -> None:
        """Raise PortError with the remedy unless a Maestro answers in three tries, with CRC as set.

        port: the port's path, for the message. Reads, and so clears, the Maestro's errors.
        """
        if all(self.read_errors() is None for _ in range(_TRIES)):
            crc = "true, and the Maestro may have it off"
            if not self.has_crc:
                crc = "false, and the Maestro may use it"
            raise PortError(
                f"{port}: no Maestro answers. Set its serial mode to USB Dual Port in Pololu's "
                "Control Center (as it comes, UART with detected rate, it ignores commands); of "
                "its two ports the lower (ttyACM0, ...-if00) is the command port; bus.crc is "
                f"{crc}"
            )
        # A Maestro without CRC takes the CRC byte of that request for a protocol error.
        if self.has_crc and (self.read_errors() or 0) & PROTOCOL_ERROR:
            raise PortError(f"{port}: the Maestro does not use a CRC; set bus.crc to false")

    def _ask(self, n_bytes: int, *commands: tuple[int, Sequence[int]]) -> bytes | None:
        """Send commands in one write; return their answers, `n_bytes` in all; None: fewer in 20 ms.

        Bytes received before are discarded.
        """
        transport = self.transport
        transport.discard_input()
        self.tell(*commands)
        deadline_s, answer = transport.clock.now() + _ANSWER_S, b""
        while len(answer) < n_bytes and transport.clock.now() < deadline_s:
            answer += transport.read(deadline_s)
        return answer if len(answer) == n_bytes else None


class PulseCommands:
    """The commands that set a face's pulses, as one block of bytes overwritten in every tick."""

    def __init__(self, maestro: Maestro, channels: Sequence[int], *, together: bool) -> None:
        """Lay out the block of commands for these channels, each servo's in the face's order.

        together: one Set Multiple Targets for each row of consecutive channels, as models above the
        Micro accept; otherwise one Set Target for each channel.
        """
        # order: indices of servos by channel; its consecutive channels are a row. places: for each
        # row, the byte at which its targets begin, and its servos; _crcs: first byte and CRC byte.
        order = sorted(range(len(channels)), key=lambda n: channels[n])
        block, places, self._crcs = bytearray(), [], []
        for _, run in groupby(enumerate(order), lambda at: together * channels[at[1]] - at[0]):
            row, start = [index for _, index in run], len(block)
            if len(row) == 1:
                packet = maestro.packet(SET_TARGET, (channels[row[0]], 0, 0))
            else:
                packet = maestro.packet(
                    SET_TARGETS, (len(row), channels[row[0]], *[0, 0] * len(row))
                )
            block += packet
            places.append((len(block) - 2 * len(row) - maestro.has_crc, row))
            if maestro.has_crc:
                self._crcs.append((start, len(block) - 1))
        self._block = block
        # For each row a view of its targets in the block, and the indices of its servos.
        self._rows = [
            (np.frombuffer(block, "<u2", len(row), at), np.array(row)) for at, row in places
        ]

    def of(self, pulses_us: Array) -> bytes:
        """Return the bytes of the commands that set these pulses.

        Parameters
        ----------
        pulses_us : Array
            (n_servos,) us.

        Returns
        -------
        bytes
            Set Multiple Targets for rows of channels, otherwise one Set Target each.
        """
        quarters = (pulses_us * QUARTERS + 0.5).astype(np.uint16)
        # A target has seven bits in each of two bytes: the upper seven bits move up by one.
        targets = quarters + (quarters & _HIGH_BITS)
        for row, servos in self._rows:
            row[:] = targets[servos]
        for start, at in self._crcs:
            self._block[at] = crc7(self._block[start:at])
        return bytes(self._block)


class MaestroController:
    """The `PulseController` of a Maestro."""

    def __init__(self, wiring: Wiring, open_transport: Callable[[], Transport]) -> None:
        """Make a closed controller. Raises ServoError for a channel that the model lacks."""
        check_channels(wiring)
        self._settings: MaestroSettings = wiring.settings
        self._channels = [each.address for each in wiring.servos]
        self._max_us_s = PulseScale(wiring.servos).max_us_s
        self._open_transport = open_transport
        self._maestro: Maestro | None = None
        self._commands: PulseCommands | None = None
        self._seen = 0
        # Of the last write: when it was, and the indices of the servos that it sent a pulse.
        self._sent_s, self._on = 0.0, list[int]()

    def open(self) -> None:
        """Open the port; change nothing yet. Raises PortError unless a Maestro answers.

        The next `send` sets the channels' speed limits again.
        """
        self.close()
        self._commands, self._on = None, []
        maestro = self._maestro = Maestro(self._open_transport(), self._settings)
        try:
            maestro.check(str(self._settings.port))
        except PortError:
            self.close()
            raise

    def close(self) -> None:
        """Close the port."""
        if self._maestro is not None:
            self._seen |= self._maestro.errors
            self._maestro.transport.close()
            self._maestro = None

    def send(self, pulses_us: Array) -> bool:
        """Write the pulses of all servos at once.

        The first write after `open` also limits the speed of each channel to its joint's. Raises
        PortError.

        Parameters
        ----------
        pulses_us : Array
            (n_servos,) us; 0: no pulse.

        Returns
        -------
        bool
            False: its serial timeout has ended all pulses since the last write. (A Maestro that
            restarts is a new USB device, and its port is lost.)
        """
        maestro, timeout_s = self._reached(), self._settings.serial_timeout_s
        now_s = maestro.transport.clock.now()
        # The timeout ends all pulses together; a late write would start all together.
        is_late = 0.0 < timeout_s < 2.0 * (now_s - self._sent_s)
        # Of a lost answer another is asked: without one nothing is known to hold.
        pulses = (self.sending(index) for index in self._on[:1] * 2)
        has_ended = is_late and bool(self._on) and not any(each > 0.0 for each in pulses)
        if has_ended:
            pulses_us = np.zeros_like(pulses_us)
        if self._commands is None:
            together = self._settings.model != WITHOUT_SET_TARGETS
            self._commands = PulseCommands(maestro, self._channels, together=together)
            units = self._max_us_s * (_SPEED_MARGIN * QUARTERS * SPEED_UNIT_S)
            for channel, speed in zip(self._channels, units.tolist(), strict=True):
                bound = split(max(1, min(LARGEST, round(speed))))
                maestro.tell((SET_SPEED, (channel, *bound)), (SET_ACCELERATION, (channel, 0, 0)))
        maestro.transport.write(self._commands.of(pulses_us))
        self._sent_s, self._on = now_s, np.flatnonzero(pulses_us).tolist()
        return not has_ended

    #: Nothing stands between a Maestro and its servos.
    is_blocked = False

    def sending(self, index: int) -> float:
        """Read the pulse that the Maestro sends to servo `index`, us; 0: none; NaN: no answer."""
        return self._reached().position_us(self._channels[index])

    def remarks(self) -> Sequence[str]:
        """Return the errors that the Maestro has reported, as sentences for a log."""
        bits = self._seen | (0 if self._maestro is None else self._maestro.errors)
        return [f"the Maestro tells of a {words}" for words in describe_errors(bits)]

    def _reached(self) -> Maestro:
        if self._maestro is None:
            raise PortError(f"{self._settings.port}: the Maestro is not open")
        return self._maestro


def check_channels(wiring: Wiring) -> None:
    """Raise ServoError for channels that the model does not have."""
    settings: MaestroSettings = wiring.settings
    beyond = [each.name for each in wiring.joints if each.servo_id >= settings.n_channels]
    if beyond:
        raise ServoError(
            f"servos {', '.join(beyond)}: a Maestro {settings.model} has channels 0 to "
            f"{settings.n_channels - 1}"
        )
