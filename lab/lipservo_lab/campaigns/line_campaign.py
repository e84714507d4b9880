"""Requests over a disturbed line to simulated servos, and whether each value is right.

A transport whose adapter echoes, delays, loses and invents bytes is put in front of the chain.
"""

import heapq
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from firmware_bridge.clock import Clock, ManualClock
from firmware_bridge.dynamixel.control_table import servo_models
from firmware_bridge.dynamixel.wire.codec import (
    ALERT_BIT,
    Instruction,
    SpanRead,
    Status,
)
from firmware_bridge.dynamixel.wire.line import Line
from firmware_bridge.dynamixel.wire.span_group import SpanGroup
from firmware_bridge.serial_servos.half_duplex import BITS_PER_BYTE
from firmware_bridge.simulator.chain import SimulatedChain


@dataclass(frozen=True, slots=True)
class Disturbance:
    """What adapter and wire do to packets; shares are 0 to 1.

    late: share of replies that come late_s (within a tenth) later, complete. lost: share of
    replies, and of requests, that never arrive. stray: share of replies with one to eight bytes of
    noise before and after. echo: what is sent comes back. fast_sync_read: whether servos know this
    instruction. latency_s: delay of every reply.
    """

    late: float = 0.0
    late_s: float = 0.025
    lost: float = 0.0
    stray: float = 0.0
    echo: bool = False
    fast_sync_read: bool = True
    latency_s: float = 0.0


class DisturbedTransport:
    """A `Transport` in virtual time; what happens to a reply is drawn from `rng`.

    sent: every packet written so far, also lost ones.
    """

    def __init__(
        self,
        chain: SimulatedChain,
        clock: Clock,
        rng: random.Random,
        disturbance: Disturbance | None = None,
        *,
        baud_rate: int = 1_000_000,
        sent: list[bytes] | None = None,
    ) -> None:
        """Put a disturbed adapter in front of a chain.

        disturbance: None: nothing is disturbed. sent: list to which written packets are appended.
        """
        self.clock = clock
        self.baud_rate = baud_rate
        self.disturbance = disturbance or Disturbance()
        self.sent: list[bytes] = [] if sent is None else sent
        self._chain = chain
        self._rng = rng
        self._on_the_way: list[tuple[float, int, bytes]] = []
        self._n = 0

    def write(self, data: bytes) -> None:
        """Put a packet on the wire, or lose it."""
        now_s = self.clock.now()
        self.sent.append(data)
        self._chain.advance(now_s)
        if self.disturbance.echo:
            self.queue(now_s + len(data) * BITS_PER_BYTE / self.baud_rate, data)
        # Byte 7 is the instruction. Servos that do not know it do not answer.
        unknown = data[7] == Instruction.FAST_SYNC_READ and not self.disturbance.fast_sync_read
        if self._rng.random() >= self.disturbance.lost and not unknown:
            self._chain.receive(data, now_s, self.baud_rate)

    def read(self, deadline_s: float) -> bytes:
        """Return the next bytes that arrive, b"" if none do until the deadline.

        The clock is set to the arrival or to the deadline.
        """
        while True:
            due_s = min(self._next_s(), self._chain.next_delivery_s)
            if due_s > deadline_s:
                self.clock.sleep_until(deadline_s)
                return b""
            self.clock.sleep_until(due_s)
            data = self.discard_input()
            if data:
                return data

    def discard_input(self) -> bytes:
        """Return the bytes that have arrived, and remove them."""
        now_s = self.clock.now()
        self._chain.advance(now_s)
        while self._chain.next_delivery_s <= now_s:
            due_s = self._chain.next_delivery_s
            self.disturb(due_s + self.disturbance.latency_s, self._chain.deliver(due_s))
        arrived = b""
        while self._next_s() <= now_s:
            arrived += heapq.heappop(self._on_the_way)[2]
        return arrived

    def close(self) -> None:
        """Forget what is on the way."""
        self._on_the_way.clear()

    def disturb(self, due_s: float, reply: bytes) -> None:
        """Let a reply that is due at `due_s` arrive: late, with noise, or not at all."""
        rng, disturbance = self._rng, self.disturbance
        if rng.random() < disturbance.lost:
            return
        if rng.random() < disturbance.late:
            due_s += disturbance.late_s * rng.uniform(0.9, 1.1)
        if rng.random() < disturbance.stray:
            reply = rng.randbytes(rng.randrange(1, 9)) + reply + rng.randbytes(rng.randrange(1, 9))
        self.queue(due_s, reply)

    def queue(self, due_s: float, data: bytes) -> None:
        """Let bytes arrive at `due_s`."""
        self._n += 1
        heapq.heappush(self._on_the_way, (due_s, self._n, data))

    def _next_s(self) -> float:
        return self._on_the_way[0][0] if self._on_the_way else float("inf")


MODEL: Final = servo_models()["XL330-M288"]
IDS: Final = (1, 2, 3, 4)
#: Registers, with their sizes, that get a new number before every request, so that an old answer is
#: noticed; and two that only the line changes.
COUNTING: Final = {
    "led": 1,
    "velocity_i_gain": 2,
    "position_p_gain": 2,
    "profile_velocity": 4,
    "goal_position": 4,
}
WRITTEN: Final = ("profile_acceleration", "position_d_gain")
_GROUP: Final = ("profile_velocity", "goal_position")
_GROUP_ADDRESS: Final = MODEL.registers["profile_velocity"].address
_GROUP_SIZE: Final = 8
#: Kinds of request; single reads are the most frequent of a face.
KINDS: Final = ("read", "read", "write", "ping", "group", "fast read", "plain read")
#: Pauses between requests; a late answer comes in between, or after several.
PAUSES_S: Final = (0.0, 0.0, 0.001, 0.02, 0.1)
#: Disturbances, each alone and together.
DISTURBANCES: Final = {
    "late": Disturbance(late=0.1),
    "echo": Disturbance(echo=True),
    "no_fast_sync_read": Disturbance(fast_sync_read=False),
    "stray_bytes": Disturbance(stray=0.2),
    "loss": Disturbance(lost=0.1),
    "together": Disturbance(late=0.1, echo=True, fast_sync_read=False, stray=0.2),
    "much_worse": Disturbance(late=0.4, late_s=0.1, stray=0.3, lost=0.1),
}


@dataclass(frozen=True, slots=True)
class Question:
    """One request, of a kind in `KINDS`, to a servo.

    register: name, for reads; value: for writes.
    """

    kind: str
    servo_id: int
    register: str
    value: int


@dataclass(frozen=True, slots=True)
class Answered:
    """Number of values that the line returned, and of those that were wrong.

    A write that was acknowledged counts as a value; it is wrong if the register holds another one.
    """

    n_values: int
    n_wrong: int


class QuestionedChain:
    """Four simulated servos and a line to them, with known register contents at every request."""

    def __init__(
        self,
        disturbance: Disturbance | None = None,
        seed: int = 0,
        make_transport: type[DisturbedTransport] = DisturbedTransport,
    ) -> None:
        """Make the servos and the line.

        seed: of the disturbances. make_transport: class of the transport between line and servos.
        """
        self.clock = ManualClock()
        self.chain = SimulatedChain([MODEL] * len(IDS), IDS, baud_rate=1_000_000)
        port = make_transport(self.chain, self.clock, random.Random(seed), disturbance)
        self.sent = port.sent
        self.line = Line(port, return_delay_s=0.0)
        self.group = SpanGroup(IDS, _GROUP_ADDRESS, _GROUP_SIZE)
        self._count = 0

    def bytes_of(self, servo_id: int, *names: str) -> bytes:
        """Return the present bytes of registers of one servo, joined."""
        servo = self.chain.servos[IDS.index(servo_id)]
        return b"".join(MODEL.registers[name].encode(servo[name]) for name in names)

    def ask(self, question: Question) -> Answered:
        """Send one request; return the answers, and how many differ from the servos' registers."""
        self._renew_registers()
        line, servo_id = self.line, question.servo_id
        if question.kind == "write":
            entry = MODEL.registers[WRITTEN[question.value % len(WRITTEN)]]
            data = entry.encode(question.value)
            status = line.write(servo_id, entry.address, data)
            acknowledged = status is not None and not status.error & ~ALERT_BIT
            is_stored = self.bytes_of(servo_id, entry.name) == data
            return Answered(status is not None, acknowledged and not is_stored)
        if question.kind == "read":
            entry = MODEL.registers[question.register]
            return self._compared(
                line.read(servo_id, entry.address, entry.size), self.bytes_of(servo_id, entry.name)
            )
        if question.kind == "ping":
            return self._compared(
                line.ping(servo_id), self.bytes_of(servo_id, "model_number", "firmware_version")
            )
        statuses = self._read_group(question.kind)
        n_wrong = sum(reply.data != self.bytes_of(reply.servo_id, *_GROUP) for reply in statuses)
        return Answered(len(statuses), n_wrong)

    def _read_group(self, kind: str) -> Sequence[Status]:
        """Read a group of registers of all servos; return the statuses.

        kind: "group", "fast read" or "plain read".
        """
        if kind == "group":
            return self.group.ask(self.line)
        span = SpanRead(IDS, _GROUP_ADDRESS, _GROUP_SIZE, fast=kind == "fast read")
        return self.line.sync_read(span)

    def _compared(self, status: Status | None, true: bytes) -> Answered:
        """Return whether an answer came, and whether its data differ from `true`."""
        return Answered(status is not None, status is not None and status.data != true)

    def _renew_registers(self) -> None:
        """Write a new number into every counting register of every servo."""
        for servo in self.chain.servos:
            for name, size in COUNTING.items():
                self._count += 1
                servo[name] = self._count % (1 << (8 * size - 1))


def ask_many(disturbance: Disturbance, n_questions: int, seed: int = 1) -> Answered:
    """Send randomly drawn requests in virtual time; return answers and wrong values of all."""
    rng = random.Random(seed)
    chain = QuestionedChain(disturbance, seed)
    n_values = n_wrong = 0
    for _ in range(n_questions):
        question = Question(
            rng.choice(KINDS), rng.choice(IDS), rng.choice(sorted(COUNTING)), rng.randrange(6)
        )
        answered = chain.ask(question)
        n_values += answered.n_values
        n_wrong += answered.n_wrong
        chain.clock.advance(rng.choice(PAUSES_S))
    return Answered(n_values, n_wrong)


def line_figures(
    n_questions: int, progress: Callable[[int, int], None]
) -> dict[str, dict[str, int]]:
    """Return requests, answers and wrong answers for each disturbance of the line.

    progress: called with the number of disturbances done, and of all.
    """
    figures = {}
    for n_done, (name, disturbance) in enumerate(DISTURBANCES.items(), start=1):
        answered = ask_many(disturbance, n_questions)
        figures[name] = {
            "questions": n_questions,
            "values": answered.n_values,
            "wrong_values": answered.n_wrong,
        }
        progress(n_done, len(DISTURBANCES))
    return figures
