"""A chain of simulated servos on one half-duplex wire: bytes in, bytes out, each at its time."""

from collections.abc import Iterable, Sequence
from typing import Final

import numpy as np

from firmware_bridge.dynamixel.codec import BROADCAST_ID, Instruction
from firmware_bridge.dynamixel.control_table import ServoModel, baud_rates
from firmware_bridge.dynamixel.frames import Frame, FrameParser
from firmware_bridge.simulator.afflictions import Afflictions
from firmware_bridge.simulator.faults import Fault
from firmware_bridge.simulator.motors import Environment, Motors
from firmware_bridge.simulator.servo import SimulatedServo
from firmware_bridge.simulator.wire import BITS_PER_BYTE, Wire, WireCounts, WireRules

#: Servos answer a broadcast ping one after another, in the order of their ids. The manual does not
#: say how far apart; the SDK waits for 14 bytes each.
_PING_SLOT_BYTES: Final = 14
#: How often the servos look at watchdog and hardware. Ours; finer than any loop.
_CHECK_S: Final = 0.010
#: Ints: looking a member up in its enumeration costs as much as comparing three.
_SYNC_WRITE: Final = int(Instruction.SYNC_WRITE)
_SYNC_READ: Final = int(Instruction.SYNC_READ)
_FAST_SYNC_READ: Final = int(Instruction.FAST_SYNC_READ)


class SimulatedChain:
    """Servos on one wire. The caller says what time it is; the same calls give the same bytes.

    Not simulated: voltage on the data line, adapters that echo (but for the fault `echo`), bytes of
    one packet arriving apart, secondary ids, protocol 1; and what `SimulatedServo` refuses.
    """

    def __init__(
        self,
        models: Sequence[ServoModel],
        ids: Sequence[int],
        *,
        environment: Environment | None = None,
        rules: WireRules | None = None,
        faults: Iterable[Fault] = (),
        seed: int = 0,
        baud_rate: int | None = None,
    ) -> None:
        """Servos fresh from the factory; a baud rate given means set up: return delay 0, too."""
        self.motors = Motors(models, environment or Environment())
        self.servos = [
            SimulatedServo(model, servo_id, index, self.motors)
            for index, (model, servo_id) in enumerate(zip(models, ids, strict=True))
        ]
        if baud_rate is not None:
            code = next(code for code, rate in baud_rates().items() if rate == baud_rate)
            for servo in self.servos:
                servo["baud_rate"] = code
                servo["return_delay_time"] = 0
        faults = tuple(faults)
        self._wire = Wire(rules or WireRules(), faults, seed)
        self._chain_stops = rules is not None and rules.chain_stops
        self._afflictions = Afflictions(self.servos, self.motors, faults)
        self._parser = FrameParser()
        self._now_s = -1.0
        self._checked_s = 0.0

    @property
    def counts(self) -> WireCounts:
        """What went over the wire so far."""
        return self._wire.counts

    @property
    def plugged(self) -> bool:
        """Whether the computer is connected to the chain."""
        return not self._afflictions.unplugged

    @property
    def plugged_in_s(self) -> float:
        """When the plug was put in last."""
        return self._afflictions.plugged_in_s

    @property
    def next_delivery_s(self) -> float:
        """When the next bytes reach the computer; infinity when none are on their way."""
        return self._wire.next_delivery_s

    def advance(self, now_s: float) -> None:
        """Let motors, watchdogs and scripted faults run until `now_s`."""
        if now_s == self._now_s:
            return
        self._now_s = now_s
        self._afflictions.advance(now_s)
        if not self.plugged:
            self._wire.clear()
            self._parser.reset()
        check = now_s - self._checked_s >= _CHECK_S
        if check:
            self._trip_watchdogs(now_s)
        self.motors.advance(now_s)
        if check:
            self._checked_s = now_s
            bits = self._afflictions.hardware_errors()
            for index in np.flatnonzero(bits).tolist():
                self.servos[index].latch(int(bits[index]))

    def _trip_watchdogs(self, now_s: float) -> None:
        """Stop those that have heard nothing for too long, each where it stood then."""
        for servo in self.servos:
            trip_s = servo.heard_s + servo.patience_s
            if trip_s <= now_s:
                self.motors.advance(trip_s)
                servo.trip_watchdog()

    def receive(self, data: bytes, now_s: float, baud_rate: int) -> None:
        """The computer writes `data` at `now_s`, at its baud rate."""
        byte_s = BITS_PER_BYTE / baud_rate
        heard, start_s = self._wire.host_speaks(data, now_s, byte_s)
        n_bad = self._parser.n_bad
        frames = self._parser.feed(heard)
        end_s = start_s + (len(heard) - len(self._parser.pending)) * byte_s
        end_s -= sum(len(frame.raw) for frame in frames) * byte_s
        for frame in frames:
            end_s += len(frame.raw) * byte_s
            self._hear(frame, max(end_s, start_s), byte_s, baud_rate)
        self.counts.bad_instructions += self._parser.n_bad - n_bad

    def deliver(self, now_s: float) -> bytes:
        """The bytes that have reached the computer by `now_s`."""
        return self._wire.deliver(now_s)

    def _hear(self, frame: Frame, end_s: float, byte_s: float, baud_rate: int) -> None:
        """Every servo of this baud rate hears one whole instruction."""
        self.counts.instructions += 1
        self.advance(end_s)
        awake = [s for s in self.servos if s.baud_rate == baud_rate and s.deaf_until_s <= end_s]
        self.counts.unheard += not awake
        for servo in awake:
            servo.heard_s = end_s
        self._wire.until_s = end_s
        instruction, parameters = frame.instruction, frame.parameters
        if instruction == _SYNC_WRITE:
            _sync_write(awake, parameters)
        elif instruction == _SYNC_READ:
            self._sync_read(awake, parameters, byte_s)
        elif instruction == _FAST_SYNC_READ:
            self._fast_sync_read(awake, parameters, byte_s)
        elif frame.packet_id == BROADCAST_ID:
            self._broadcast(awake, instruction, parameters, byte_s)
        else:
            for servo in [each for each in awake if each.servo_id == frame.packet_id]:
                answer = servo.answer(instruction, parameters, end_s)
                if answer is not None:
                    self._wire.say(servo, frame.packet_id, answer, end_s, byte_s)

    def _broadcast(
        self, awake: list[SimulatedServo], instruction: int, parameters: bytes, byte_s: float
    ) -> None:
        """Nobody answers, but to a ping. A reset of everything is ignored, as the manual says."""
        if instruction == Instruction.FACTORY_RESET and parameters[:1] == b"\xff":
            return
        end_s = self._wire.until_s
        for servo in sorted(awake, key=lambda each: each.servo_id):
            answer = servo.answer(instruction, parameters, end_s)
            if instruction == Instruction.PING and answer is not None:
                slot_s = servo.servo_id * _PING_SLOT_BYTES * byte_s
                self._wire.say(servo, servo.servo_id, answer, end_s + slot_s, byte_s)

    def _sync_read(self, awake: list[SimulatedServo], parameters: bytes, byte_s: float) -> None:
        """Each in its turn; a silent servo leaves a gap of its own length, or stops the rest."""
        if len(parameters) < 5:
            return
        address = parameters[0] | parameters[1] << 8
        size = parameters[2] | parameters[3] << 8
        by_id = _by_id(awake)
        for servo_id in parameters[4:]:
            answering = by_id.get(servo_id)
            if not answering:
                if self._chain_stops:
                    return
                self._wire.until_s += (11 + size) * byte_s
                continue
            start_s = self._wire.until_s
            for servo in answering:
                said = servo.read_span(address, size)
                self._wire.say(servo, servo_id, said, start_s, byte_s)

    def _fast_sync_read(
        self, awake: list[SimulatedServo], parameters: bytes, byte_s: float
    ) -> None:
        """All in one frame, which ends where somebody is silent."""
        if len(parameters) < 5:
            return
        address = parameters[0] | parameters[1] << 8
        size = parameters[2] | parameters[3] << 8
        by_id, ids = _by_id(awake), parameters[4:]
        said = []
        for servo_id in ids:
            answering = by_id.get(servo_id)
            if not answering or self._wire.swallows(answering[0]):
                break
            error, data = answering[0].read_span(address, size)
            if len(data) != size:
                break
            said.append((answering[0], error, data))
        if said:
            self._wire.say_together(said, len(ids) - len(said), self._wire.until_s, byte_s)


def _by_id(awake: list[SimulatedServo]) -> dict[int, list[SimulatedServo]]:
    """Who answers to which id; more than one when an id was given twice."""
    by_id: dict[int, list[SimulatedServo]] = {}
    for servo in awake:
        if servo.answers_reads:
            by_id.setdefault(servo.servo_id, []).append(servo)
    return by_id


def _sync_write(awake: list[SimulatedServo], parameters: bytes) -> None:
    if len(parameters) < 5:
        return
    head = parameters[:2]
    size = parameters[2] | parameters[3] << 8
    blocks = {
        parameters[at]: parameters[at + 1 : at + 1 + size]
        for at in range(4, len(parameters) - size, size + 1)
    }
    for servo in awake:
        data = blocks.get(servo.servo_id)
        if data is not None:
            servo.write(head + data)
