"""Questions over a disturbed line, and whether each value is the one that its register held."""

import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

from firmware_bridge.clock import ManualClock
from firmware_bridge.dynamixel.control_table import servo_models
from firmware_bridge.dynamixel.wire.codec import ALERT_BIT, Status
from firmware_bridge.dynamixel.wire.line import Line, SpanRead
from firmware_bridge.dynamixel.wire.span_group import SpanGroup
from firmware_bridge.simulator.chain import SimulatedChain
from lipservo_lab.campaigns.disturbed_transport import (
    Disturbance,
    DisturbedTransport,
)

MODEL: Final = servo_models()["XL330-M288"]
IDS: Final = (1, 2, 3, 4)
#: Registers with their sizes that hold another number at every question, so that an old answer
#: shows; and two that nobody but the line changes.
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
#: Single reads are what a face asks most.
KINDS: Final = ("read", "read", "write", "ping", "group", "fast read", "plain read")
#: From one question to the next; a late answer comes in between, or after several.
PAUSES_S: Final = (0.0, 0.0, 0.001, 0.02, 0.1)
#: What is disturbed, each alone and together.
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
    """One of `KINDS` to a servo, about a register; value: what a write writes."""

    kind: str
    servo_id: int
    register: str
    value: int


@dataclass(frozen=True, slots=True)
class Answered:
    """What came of questions: values that the line gave out, and those that were wrong.

    A write that was acknowledged counts as a value; it is wrong where the register holds another.
    """

    n_values: int
    n_wrong: int


class QuestionedChain:
    """Four simulated servos, a line to them, and what is true at every question."""

    def __init__(
        self,
        disturbance: Disturbance | None = None,
        seed: int = 0,
        make_transport: type[DisturbedTransport] = DisturbedTransport,
    ) -> None:
        self.clock = ManualClock()
        self.chain = SimulatedChain([MODEL] * len(IDS), IDS, baud_rate=1_000_000)
        port = make_transport(self.chain, self.clock, random.Random(seed), disturbance)
        self.sent = port.sent
        self.line = Line(port, return_delay_s=0.0)
        self.group = SpanGroup(IDS, _GROUP_ADDRESS, _GROUP_SIZE)
        self._count = 0

    def bytes_of(self, servo_id: int, *names: str) -> bytes:
        """What these registers of one servo hold now."""
        servo = self.chain.servos[IDS.index(servo_id)]
        return b"".join(MODEL.registers[name].encode(servo[name]) for name in names)

    def ask(self, question: Question) -> Answered:
        """Put one question; every value that comes is compared with the servo's registers."""
        self._count_on()
        line, servo_id = self.line, question.servo_id
        if question.kind == "write":
            entry = MODEL.registers[WRITTEN[question.value % len(WRITTEN)]]
            data = entry.encode(question.value)
            status = line.write(servo_id, entry.address, data)
            taken = status is not None and not status.error & ~ALERT_BIT
            kept = self.bytes_of(servo_id, entry.name) == data
            return Answered(status is not None, taken and not kept)
        if question.kind == "read":
            entry = MODEL.registers[question.register]
            return self._compared(
                line.read(servo_id, entry.address, entry.size), self.bytes_of(servo_id, entry.name)
            )
        if question.kind == "ping":
            return self._compared(
                line.ping(servo_id), self.bytes_of(servo_id, "model_number", "firmware_version")
            )
        statuses = self._ask_all(question.kind)
        n_wrong = sum(each.data != self.bytes_of(each.servo_id, *_GROUP) for each in statuses)
        return Answered(len(statuses), n_wrong)

    def _ask_all(self, kind: str) -> Sequence[Status]:
        if kind == "group":
            return self.group.ask(self.line)
        span = SpanRead(IDS, _GROUP_ADDRESS, _GROUP_SIZE, fast=kind == "fast read")
        return self.line.sync_read(span)

    def _compared(self, status: Status | None, true: bytes) -> Answered:
        return Answered(status is not None, status is not None and status.data != true)

    def _count_on(self) -> None:
        """Give every counting register of every servo a number that it never had."""
        for servo in self.chain.servos:
            for name, size in COUNTING.items():
                self._count += 1
                servo[name] = self._count % (1 << (8 * size - 1))


def ask_many(disturbance: Disturbance, n_questions: int, seed: int = 1) -> Answered:
    """Ask drawn questions one after another, in virtual time; what came of all of them."""
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
    """Questions asked, values that came and values that were wrong, by disturbance.

    progress: called with disturbances done and all of them.
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
