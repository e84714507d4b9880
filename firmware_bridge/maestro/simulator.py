"""Simulate a Pololu Maestro, to the byte, and the shafts of its servos.

The Maestro is in memory or behind a pseudo-terminal. Tests check the pulses that the simulator
logs, not the values that the Maestro reports.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal, get_args

import numpy as np

from firmware_bridge.bus import Array, ServoBus
from firmware_bridge.bus_kinds import Wiring
from firmware_bridge.clock import ManualClock
from firmware_bridge.maestro import protocol
from firmware_bridge.maestro.controller import MaestroController, check_channels
from firmware_bridge.maestro.kind import BAUD_RATE, MAESTRO
from firmware_bridge.maestro.settings import MaestroSettings
from firmware_bridge.pulse_bus import PulseBus
from firmware_bridge.pulse_servos import PulseScale
from firmware_bridge.simulation_request import (
    DueFaults,
    SimulationRequest,
    TimedFault,
    parse_faults,
)
from firmware_bridge.simulator.ports import MemoryTransport, PtyHost, WatchedServos

#: Pulse limits as set in the factory: https://www.pololu.com/docs/0J40/4.b .
_SHORTEST_US, _LONGEST_US = 992.0, 2000.0
#: A hobby servo of the usual size turns 60 degrees in .15 s; 500 us are 45 degrees.
_SHAFT_US_S: Final = 4_400.0
#: Answers come with the next frame of USB.
_USB_S: Final = 0.001
#: How long the USB port is gone during a restart; our assumption.
_RESTART_S: Final = 0.5
_FOREVER: Final = float("inf")


class PulseFault(TimedFault):
    """One fault of a simulated Maestro, of a `kind`, as a fault script lists it.

    brown-out: its supply fails shortly. deaf: it ignores commands from then on. truncate, corrupt:
    the next bytes that it receives are cut in half, or one bit of them changes. unplug: its port is
    gone for lasts_s.
    """

    kind: Literal["brown-out", "deaf", "truncate", "corrupt", "unplug"]


#: Kinds of faults.
FAULTS: Final = get_args(PulseFault.model_fields["kind"].annotation)


def read_faults(text: str | None) -> Sequence[PulseFault]:
    """Return the faults in the YAML `text`, none for None. Raises ValueError for bad YAML."""
    return parse_faults(text, PulseFault)


class Shaft:
    """The position of a hobby servo's shaft, as the pulse in us that would hold it there.

    The shaft moves towards its pulse at constant speed. Without pulses it holds its position, as
    that of a digital servo does.
    """

    def __init__(self, place_us: float = 1500.0) -> None:
        self.place_us = place_us

    def move(self, pulse_us: float, seconds: float) -> None:
        """Move the shaft for `seconds`: towards `pulse_us`; 0: no pulse."""
        if pulse_us:
            reach_us = _SHAFT_US_S * seconds
            self.place_us += min(max(pulse_us - self.place_us, -reach_us), reach_us)


@dataclass(frozen=True, slots=True)
class Pulse:
    """A change of one channel to `pulse_us` (0: no pulse), and its shaft's position then, in us."""

    time_s: float
    channel: int
    pulse_us: float
    shaft_us: float


class _Channel:
    """One output: target, speed limit and present pulse in quarters of a us, and the shaft."""

    def __init__(self) -> None:
        self.target = self.speed = self.acceleration = 0
        self.position = 0.0
        self.shaft = Shaft()

    def set_target(self, target: int, shortest: float, longest: float) -> None:
        """Set the pulse to approach to `target`, clipped to shortest..longest; 0: pulses off.

        A channel that was off, or has no speed limit, jumps to its target. All values are in
        quarters of a us.
        """
        self.target = round(min(max(target, shortest), longest)) if target else 0
        if not (target and self.position and self.speed):
            self.position = self.target

    def move(self, seconds: float) -> None:
        """Move the pulse towards its target, and the shaft towards the pulse, for `seconds`."""
        if self.position != self.target:
            reach = self.speed * seconds / protocol.SPEED_UNIT_S if self.speed else float("inf")
            self.position += min(max(self.target - self.position, -reach), reach)
        self.shaft.move(self.position / protocol.QUARTERS, seconds)


class SimulatedMaestro:
    """A simulated Maestro: a `SimulatedDevice` that obeys commands and logs its pulses.

    deaf: whether it ignores all commands, as in the factory's serial mode. Tests read `channels`,
    and the log `pulses`.
    """

    def __init__(
        self,
        settings: MaestroSettings,
        *,
        faults: Sequence[PulseFault] = (),
        deaf: bool = False,
        range_us: tuple[float, float] = (_SHORTEST_US, _LONGEST_US),
        on_pulse: Callable[[Pulse], None] | None = None,
    ) -> None:
        """Start with all channels off.

        faults: happen at their times. range_us: shortest and longest pulse of a channel; targets
        outside are clipped. on_pulse: called with every change of a pulse, which `pulses` logs as
        well.
        """
        self._crc, self._device = settings.crc, settings.device
        self._is_micro = settings.model == protocol.WITHOUT_SET_TARGETS
        self._timeout_s = settings.serial_timeout_s or _FOREVER
        self._range = range_us[0] * protocol.QUARTERS, range_us[1] * protocol.QUARTERS
        self.channels = [_Channel() for _ in range(settings.n_channels)]
        self.pulses: deque[Pulse] = deque(maxlen=100_000)
        self._on_pulse = on_pulse or (lambda _pulse: None)
        self.errors, self.deaf = 0, deaf
        self._faults = DueFaults(faults)
        self._cut = self._damage = False
        self._back_s = -_FOREVER
        self._now_s = self._heard_s = 0.0
        self._message = bytearray()
        self._answers: deque[tuple[float, bytes]] = deque()

    @property
    def plugged(self) -> bool:
        """Whether the Maestro's port exists: False while it is unplugged or restarts."""
        return self._now_s >= self._back_s

    @property
    def next_delivery_s(self) -> float:
        """The time in s at which the next answer reaches the computer; infinity: none is due."""
        return self._answers[0][0] if self._answers else _FOREVER

    def advance(self, now_s: float) -> None:
        """Simulate channels, shafts, serial timeout and faults up to `now_s`, in steps of 20 ms.

        An earlier time does nothing. Every change of a pulse is logged.
        """
        while self._now_s < now_s:
            step_s = min(0.02, now_s - self._now_s)
            self._now_s += step_s
            for number, channel in enumerate(self.channels):
                before = channel.position
                channel.move(step_s)
                if channel.position != before:
                    self._log(number)
        if now_s - self._heard_s > self._timeout_s and not self.errors & protocol.TIMEOUT_ERROR:
            self._fail(protocol.TIMEOUT_ERROR)
        for _, fault in self._faults.take(now_s):
            if fault.kind == "brown-out":
                self.brown_out()
            elif fault.kind == "deaf":
                self.deaf = True
            elif fault.kind == "truncate":
                self._cut = True
            elif fault.kind == "corrupt":
                self._damage = True
            else:
                self.unplug(fault.lasts_s)

    def receive(self, data: bytes, now_s: float, _baud_rate: int) -> None:
        """Obey the commands in `data`, received at `now_s`; ignore all while deaf or unplugged.

        A command byte inside another command, or a data byte without a command, is a protocol
        error. A command that is not whole yet stays in `_message`.
        """
        self.advance(now_s)
        if self.deaf or not self.plugged:
            return
        # Faults `truncate` and `corrupt`: half of the bytes arrive, or one bit changes.
        if self._cut:
            data, self._cut = data[: len(data) // 2], False
        if self._damage and data:
            data, self._damage = data[:-1] + bytes((data[-1] ^ 1,)), False
        for byte in data:
            if byte & 0x80 and self._message:
                self._message.clear()
                self._fail(protocol.PROTOCOL_ERROR)
            if not (byte & 0x80 or self._message):
                self._fail(protocol.PROTOCOL_ERROR)
                continue
            self._message.append(byte)
            if self._n_missing() <= 0:
                message = bytes(self._message)
                self._message.clear()
                self._obey(message, now_s)

    def deliver(self, now_s: float) -> bytes:
        """Return and remove the answers that have reached the computer by `now_s`; b"": none."""
        answers = b""
        while self._answers and self._answers[0][0] <= now_s:
            answers += self._answers.popleft()[1]
        return answers

    def brown_out(self) -> None:
        """Simulate a short failure of the supply: all channels off, the USB port gone for .5 s."""
        self.unplug(_RESTART_S)
        self.errors = 0
        for number, channel in enumerate(self.channels):
            channel.target = channel.speed = channel.acceleration = 0
            channel.position = 0.0
            self._log(number)

    def unplug(self, seconds: float) -> None:
        """Remove the USB port for `seconds`; pulses continue: the servo supply stays on."""
        self._back_s = self._now_s + seconds
        self._answers.clear()
        self._message.clear()

    def _n_missing(self) -> int:
        """Return how many bytes the command being received still lacks; 0 or less: it is whole.

        While the command's length is not known yet, a lower bound of at least 1 is returned.
        """
        # head: bytes before the data: the command, or 0xAA, device number and command
        message = self._message
        head = 3 if message[0] == protocol.POLOLU else 1
        if len(message) < head:
            return 1
        code = message[0] if head == 1 else message[2] | 0x80
        if code == protocol.SET_TARGETS:
            n_data = 2 + 2 * message[head] if len(message) > head else 2
        else:
            n_data = protocol.N_DATA.get(code, 0)
        return head + n_data + self._crc - len(message)

    def _obey(self, message: bytes, now_s: float) -> None:
        """Carry out a whole command, unless it is for another device number.

        A wrong CRC, an unknown command or a missing channel is an error, which switches all pulses
        off.
        """
        if self._crc:
            message, checksum = message[:-1], message[-1]
            if checksum != protocol.crc7(message):
                self._fail(protocol.CRC_ERROR)
                return
        code, data = message[0], message[1:]
        if code == protocol.POLOLU:
            if self._device not in (None, data[0]):
                return
            code, data = data[1] | 0x80, data[2:]
        self._heard_s = now_s
        n = len(self.channels)
        sets_several = code == protocol.SET_TARGETS and not self._is_micro
        if sets_several and data[0] and data[1] + data[0] <= n:
            for each in range(data[0]):
                self._set_target(data[1] + each, data[2 + 2 * each : 4 + 2 * each])
        elif code == protocol.SET_TARGET and data[0] < n:
            self._set_target(data[0], data[1:])
        elif code in (protocol.SET_SPEED, protocol.SET_ACCELERATION) and data[0] < n:
            name = "speed" if code == protocol.SET_SPEED else "acceleration"
            setattr(self.channels[data[0]], name, data[1] | data[2] << 7)
        elif code == protocol.GET_POSITION and data[0] < n:
            self._answer(round(self.channels[data[0]].position), now_s)
        elif code == protocol.GET_ERRORS:
            self._answer(self.errors, now_s)
            self.errors = 0
        elif code == protocol.GO_HOME:
            self._go_home()
        else:
            self._fail(protocol.PROTOCOL_ERROR)

    def _set_target(self, number: int, data: bytes) -> None:
        channel = self.channels[number]
        before = channel.position
        channel.set_target(data[0] | data[1] << 7, *self._range)
        if channel.position != before:
            self._log(number)

    def _answer(self, value: int, now_s: float) -> None:
        self._answers.append((now_s + _USB_S, value.to_bytes(2, "little")))

    def _fail(self, error: int) -> None:
        self.errors |= error
        self._go_home()

    def _go_home(self) -> None:
        """Switch off every channel that sends pulses: the factory setting for an error."""
        for number, channel in enumerate(self.channels):
            if channel.position:
                channel.target, channel.position = 0, 0.0
                self._log(number)

    def _log(self, number: int) -> None:
        channel = self.channels[number]
        place_us = round(channel.shaft.place_us, 1)
        pulse = Pulse(self._now_s, number, channel.position / protocol.QUARTERS, place_us)
        self.pulses.append(pulse)
        self._on_pulse(pulse)


def maestro_for(wiring: Wiring, **options: Any) -> SimulatedMaestro:
    """Return a simulated Maestro with the settings and pulse limits of the face in `wiring`.

    options: as for `SimulatedMaestro`. Raises ServoError for servos at channels that the model
    lacks.
    """
    check_channels(wiring)
    shortest = min((each.min_us for each in wiring.servos), default=_SHORTEST_US)
    longest = max((each.max_us for each in wiring.servos), default=_LONGEST_US)
    range_us = min(shortest, _SHORTEST_US), max(longest, _LONGEST_US)
    return SimulatedMaestro(wiring.settings, range_us=range_us, **options)


def watched_servos(wiring: Wiring, **options: Any) -> WatchedServos:
    """Return a face's servos simulated in memory: bus, clock, Maestro, and shaft angles, for tests.

    options: as for `SimulatedMaestro`. The clock is moved by hand. Servos may start without a known
    position.
    """
    maestro, clock = maestro_for(wiring, **options), ManualClock()
    controller = MaestroController(wiring, lambda: MemoryTransport(maestro, clock, BAUD_RATE))
    can, scale = MAESTRO.capabilities(wiring.settings), PulseScale(wiring.servos)
    bus = PulseBus(wiring.servos, controller, clock, can, may_jump=True)

    def shafts_deg() -> Array:
        maestro.advance(clock.now())
        places = [maestro.channels[each.channel].shaft.place_us for each in wiring.servos]
        return scale.joints_deg(np.array(places))

    return WatchedServos(
        bus, clock, maestro, shafts_deg, lambda: maestro.plugged and not maestro.deaf
    )


def simulated_wire(wiring: Wiring) -> tuple[ServoBus, ManualClock]:
    """Return the bus of a face's servos simulated in memory, and the clock that moves them."""
    watched = watched_servos(wiring)
    return watched.bus, watched.clock


def serve(wiring: Wiring | None, link: Path | None, request: SimulationRequest) -> PtyHost:
    """Return a host that serves a simulated Maestro at a pseudo-terminal.

    wiring: the servos of the face that is simulated; None: a Micro 6 without a face. link: path of
    a symbolic link to the terminal. request.log: a file that gets every change of a pulse as a line
    of JSON: seconds since the start, channel, pulse and shaft in us. Raises ServoError for channels
    that the model lacks and for a log that cannot be written, ValueError for an invalid script, and
    PortError where no terminal or link can be made.
    """
    script = read_faults(request.faults)
    write = request.row_log()

    def on_pulse(pulse: Pulse) -> None:
        write((round(pulse.time_s, 6), pulse.channel, pulse.pulse_us, pulse.shaft_us))

    if wiring is None:
        wiring = Wiring(MaestroSettings(model=protocol.WITHOUT_SET_TARGETS), (), (), 50.0)
    return PtyHost(maestro_for(wiring, faults=script, on_pulse=on_pulse), link)
