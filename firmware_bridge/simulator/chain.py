"""A chain of simulated Dynamixels on one half-duplex wire: bytes in and out, each at its time."""

import struct
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from firmware_bridge.bus import Array
from firmware_bridge.dynamixel.control_table import ServoModel, baud_rates
from firmware_bridge.dynamixel.mounting import MountedServo
from firmware_bridge.dynamixel.provisioning import wanted_settings
from firmware_bridge.dynamixel.wire.codec import BROADCAST_ID, Frame, FrameParser, Instruction
from firmware_bridge.serial_servos.half_duplex import BITS_PER_BYTE
from firmware_bridge.simulator.faults import Fault, FaultInjector
from firmware_bridge.simulator.motors import PULSES_PER_DEG, Environment, Motors
from firmware_bridge.simulator.servo import SimulatedServo
from firmware_bridge.simulator.wire import Wire, WireRules


class SpanWanted(NamedTuple):
    """The `size` bytes from `address` on that a group read requests from one servo."""

    servo_id: int
    address: int
    size: int


def sync_read(parameters: bytes) -> list[SpanWanted]:
    """Return the spans that a sync read requests, one span for all ids; [] if it is too short.

    An id named twice counts once, as named first.
    """
    if len(parameters) < 5:
        return []
    address, size = struct.unpack_from("<HH", parameters)
    return [SpanWanted(servo_id, address, size) for servo_id in dict.fromkeys(parameters[4:])]


def bulk_read(parameters: bytes) -> list[SpanWanted]:
    """Return the spans that a bulk read requests, one for each id; an id's first span counts.

    parameters: five bytes for each servo: id, address (2), size (2); an unfinished rest is ignored.
    """
    wanted: dict[int, SpanWanted] = {}
    whole = parameters[: len(parameters) // 5 * 5]
    for span in map(SpanWanted._make, struct.iter_unpack("<BHH", whole)):
        wanted.setdefault(span.servo_id, span)
    return list(wanted.values())


def sync_write(parameters: bytes) -> dict[int, bytes]:
    """Split a sync write into the parameters of plain writes, by id; an id's last block counts.

    parameters: address (2 bytes), size (2), then id and `size` bytes for each servo. {}: too short.
    """
    if len(parameters) < 5:
        return {}
    head = parameters[:2]
    size = parameters[2] | parameters[3] << 8
    return {
        parameters[at]: head + parameters[at + 1 : at + 1 + size]
        for at in range(4, len(parameters) - size, size + 1)
    }


def bulk_write(parameters: bytes) -> dict[int, bytes]:
    """Split a bulk write into parameters of plain writes, by id; a block cut short is left out.

    parameters: for each servo id, address (2 bytes), size (2), and so many bytes. An id's last
    block counts.
    """
    blocks: dict[int, bytes] = {}
    at = 0
    while at + 5 <= len(parameters):
        end = at + 5 + (parameters[at + 3] | parameters[at + 4] << 8)
        if end <= len(parameters):
            blocks[parameters[at]] = parameters[at + 1 : at + 3] + parameters[at + 5 : end]
        at = end
    return blocks


#: Servos answer a broadcast ping one after another, in the order of their ids. The manual does not
#: say how far apart; the SDK waits for 14 bytes each.
_PING_SLOT_BYTES: Final = 14
#: How often servos check watchdog and hardware errors. Our choice; finer than any control loop.
_CHECK_S: Final = 0.010
#: Ints: looking a member up in its enumeration costs as much as comparing three.
_GROUP_READS: Final = {
    int(Instruction.SYNC_READ): (sync_read, False),
    int(Instruction.FAST_SYNC_READ): (sync_read, True),
    int(Instruction.BULK_READ): (bulk_read, False),
    int(Instruction.FAST_BULK_READ): (bulk_read, True),
}
_GROUP_WRITES: Final = {
    int(Instruction.SYNC_WRITE): sync_write,
    int(Instruction.BULK_WRITE): bulk_write,
}
#: Servos that answer reads, by id; several if they have the same id.
_ById = dict[int, list[SimulatedServo]]


class SimulatedChain:
    """Simulated Dynamixels on one wire, as a `SimulatedDevice`; callers pass the time.

    Equal calls give equal bytes. Not simulated: voltage on the data line, adapters that echo (but
    for the fault `echo`), bytes of one packet arriving apart, secondary ids, protocol 1; and what
    `SimulatedServo` refuses.
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
        """Make servos of `models` with these `ids` and factory settings.

        environment, rules: what the manual does not state. faults: of a fault script; seed: of
        those that happen by chance. baud_rate: all servos are set to it, with return delay 0; None:
        the factory's rate and delay.
        """
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
        self._wire = Wire(faults, seed)
        self.counts = self._wire.counts
        self._chain_stops = rules is not None and rules.chain_stops
        self._afflictions = FaultInjector(self.servos, self.motors, faults)
        self._parser = FrameParser()
        self._now_s = -1.0
        self._checked_s = 0.0
        self._cut_off = False

    def turn(self, index: int, by_deg: float) -> None:
        """Turn a limp servo's shaft by `by_deg` as by hand; with torque on the shaft stays."""
        if 0 <= index < len(self.servos) and not self.motors.torque_on[index]:
            self.motors.position[index] += by_deg * PULSES_PER_DEG

    @property
    def plugged(self) -> bool:
        """Whether the computer is connected to the chain."""
        return not self._afflictions.unplugged

    @property
    def motion(self) -> Callable[[float, Array], None] | None:
        """The callback for every 5 ms step of the motion; None, the default, costs nothing.

        Positions are pulses as `Motors` counts them, which is as present_position does for servos
        that are neither reversed nor given a homing offset. The array is the motors' own: copy what
        is kept.

        Returns
        -------
        Callable[[float, Array], None] | None
            Called with the time in s, and the shafts' positions, (n_servos,) pulses.
        """
        return self.motors.motion

    @motion.setter
    def motion(self, observer: Callable[[float, Array], None] | None) -> None:
        self.motors.motion = observer

    def unplug(self) -> None:
        """Disconnect the computer: bytes under way are lost, servos keep their power.

        May be called from any thread; a `PtyHost` hangs up within 50 ms.
        """
        self._cut_off = True
        self._afflictions.unplugged = True

    def plug_in(self) -> None:
        """Connect the computer again; a `PtyHost` opens a new port, and its link leads there."""
        self._afflictions.unplugged = False

    @property
    def next_delivery_s(self) -> float:
        """The time in s of the next bytes to the computer; infinity: none are under way."""
        return self._wire.next_delivery_s

    def advance(self, now_s: float) -> None:
        """Simulate motors, watchdogs and scripted faults until `now_s`.

        Watchdogs and hardware errors are checked every 10 ms. Once unplugged, the bytes under way
        are dropped.
        """
        if now_s == self._now_s:
            return
        self._now_s = now_s
        self._afflictions.advance(now_s)
        if self._cut_off or not self.plugged:
            self._cut_off = False
            self._wire.clear()
            self._parser.reset()
        check = now_s - self._checked_s >= _CHECK_S
        if check:
            self._look_at_clocks(now_s)
        self.motors.advance(now_s)
        if check:
            self._checked_s = now_s
            bits = self._afflictions.hardware_errors()  # (n_servos,)
            for index in np.flatnonzero(bits).tolist():
                self.servos[index].latch(int(bits[index]))

    def _look_at_clocks(self, now_s: float) -> None:
        """Trip the bus watchdogs due by `now_s`, with each motor where it was when its was due.

        Servos that are set to switch torque on at start-up do so here once they have booted.
        """
        for servo in self.servos:
            if servo.holds_at_start:
                servo.start_up(now_s)
            trip_s = servo.heard_s + servo.watchdog_timeout_s
            if trip_s <= now_s:
                self.motors.advance(trip_s)
                servo.trip_watchdog()

    def receive(self, data: bytes, now_s: float, baud_rate: int) -> None:
        """Parse the bytes that the computer writes at `now_s` at its baud rate, and obey them.

        Each packet is executed at the time at which its last byte is on the wire. An unfinished one
        stays in the parser.
        """
        byte_s = BITS_PER_BYTE / baud_rate
        heard, start_s = self._wire.host_speaks(data, now_s, byte_s)
        frames = self._parser.feed(heard)
        # First when the last packet ends; less all packets: when the first one begins.
        end_s = start_s + (len(heard) - len(self._parser.pending)) * byte_s
        end_s -= sum(len(frame.raw) for frame in frames) * byte_s
        for frame in frames:
            end_s += len(frame.raw) * byte_s
            self._hear(frame, max(end_s, start_s), byte_s, baud_rate)

    def deliver(self, now_s: float) -> bytes:
        """Return and remove the bytes that have reached the computer by `now_s`; b"": none."""
        return self._wire.deliver(now_s)

    def _hear(self, frame: Frame, end_s: float, byte_s: float, baud_rate: int) -> None:
        """Execute an instruction whose last byte arrives at `end_s`; queue the replies.

        Only servos that listen at `baud_rate` execute it. byte_s: seconds a byte at that rate.
        """
        self.advance(end_s)
        listening = [s for s in self.servos if s.baud_rate == baud_rate and s.deaf_until_s <= end_s]
        # Any packet, whichever servo it is for, restarts the bus watchdogs of all that receive it.
        for servo in listening:
            servo.heard_s = end_s
        self._wire.until_s = end_s
        instruction, parameters = frame.instruction, frame.parameters
        if frame.packet_id != BROADCAST_ID:
            listening = [each for each in listening if each.servo_id == frame.packet_id]
        if instruction in _GROUP_WRITES:
            blocks = _GROUP_WRITES[instruction](parameters)
            for servo in listening:
                if (block := blocks.get(servo.servo_id)) is not None:
                    servo.write(block)
        elif instruction in _GROUP_READS:
            take_apart, fast = _GROUP_READS[instruction]
            wanted = take_apart(parameters)
            if frame.packet_id != BROADCAST_ID:  # other servos ignore the packet
                wanted = [each for each in wanted if each.servo_id == frame.packet_id]
            answering = _by_id(listening)
            (self._read_together if fast else self._read_in_turn)(answering, wanted, byte_s)
        elif frame.packet_id == BROADCAST_ID:
            self._broadcast(listening, instruction, parameters, byte_s)
        else:
            for servo in listening:
                answer = servo.answer(instruction, parameters, end_s)
                if answer is not None:
                    self._wire.say(servo, frame.packet_id, answer, end_s, byte_s)

    def _broadcast(
        self, listening: list[SimulatedServo], instruction: int, parameters: bytes, byte_s: float
    ) -> None:
        """Execute a broadcast instruction on the servos `listening`; only a ping is answered.

        A factory reset of everything is ignored, as the manual says.
        """
        if instruction == Instruction.FACTORY_RESET and parameters[:1] == b"\xff":
            return
        end_s = self._wire.until_s
        for servo in sorted(listening, key=lambda each: each.servo_id):
            answer = servo.answer(instruction, parameters, end_s)
            if instruction == Instruction.PING and answer is not None:
                slot_s = servo.servo_id * _PING_SLOT_BYTES * byte_s
                self._wire.say(servo, servo.servo_id, answer, end_s + slot_s, byte_s)

    def _read_in_turn(self, by_id: _ById, wanted: list[SpanWanted], byte_s: float) -> None:
        """Answer a group read for the spans `wanted`, one servo after another.

        by_id: servos that received the request and answer; byte_s: seconds a byte. A silent servo
        leaves a gap, or, by the rule `chain_stops`, ends the answers.
        """
        for servo_id, address, size in wanted:
            answering = by_id.get(servo_id)
            if not answering:
                if self._chain_stops:
                    return
                # as long as the silent servo's packet would take
                self._wire.until_s += (11 + size) * byte_s
                continue
            start_s = self._wire.until_s
            for servo in answering:
                data = servo.read_span(address, size)
                self._wire.say(servo, servo_id, data, start_s, byte_s)

    def _read_together(self, by_id: _ById, wanted: list[SpanWanted], byte_s: float) -> None:
        """Answer a fast group read (spans `wanted`) in one frame, cut at the first silent servo.

        by_id: servos that received the request and answer; byte_s: seconds a byte. An invalid span
        cuts the frame as well; if the first servo is silent, there is no frame.
        """
        replies = []
        for servo_id, address, size in wanted:
            answering = by_id.get(servo_id)
            if not answering or self._wire.swallows(answering[0]):
                break
            error, data = answering[0].read_span(address, size)
            if len(data) != size:
                break
            replies.append((answering[0], error, data))
        if replies:
            missing = [each.size for each in wanted[len(replies) :]]
            self._wire.say_together(replies, missing, self._wire.until_s, byte_s)


def _by_id(listening: list[SimulatedServo]) -> _ById:
    """Return those of `listening` that answer reads, by id; several if they have the same id."""
    by_id: _ById = {}
    for servo in listening:
        if servo.answers_reads:
            by_id.setdefault(servo.servo_id, []).append(servo)
    return by_id


def chain_for(servos: Sequence[MountedServo], baud_rate: int, **options: Any) -> SimulatedChain:
    """Return a chain of a face's servos with their ids, rate and limits, limp in neutral.

    options: keyword arguments of `SimulatedChain`.
    """
    chain = SimulatedChain(
        [servo.model for servo in servos],
        [servo.joint.servo_id for servo in servos],
        baud_rate=baud_rate,
        **options,
    )
    for servo, simulated in zip(servos, chain.servos, strict=True):
        for name, value in wanted_settings(servo, baud_rate).items():
            simulated[name] = value
        simulated.power_up(0.0)
        simulated.stand_at(servo.pulse(0.0))
    return chain
