"""The half-duplex wire of a simulated chain: timing, collisions, loss and delivery of packets."""

import random
from bisect import bisect_right, insort
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

from firmware_bridge.dynamixel.wire.codec import fast_status, status
from firmware_bridge.simulator.faults import ON_INSTRUCTIONS, ON_REPLIES, Fault
from firmware_bridge.simulator.servo import SimulatedServo

#: Times that differ by less are equal: sums of byte times are rounded. A bit lasts 220 ns at least.
_SAME_S: Final = 1e-9
#: The bytes that the fault `echo` puts before a reply: a broadcast ping.
_ECHO: Final = b"\xff\xff\xfd\x00\xfe\x03\x00\x01\x31\x42"


@dataclass(slots=True)
class WireCounts:
    """The number of collisions on the wire so far.

    contention: two packets at once, though each was sent when it was due. Not counted is what the
    computer sends over bytes that a fault made late, double or noise: it could not foresee them.
    """

    contention: int = 0


@dataclass(frozen=True, slots=True)
class WireRules:
    """Behaviour in which hardware may differ and the manual is silent.

    chain_stops: servos after a silent one do not answer a sync read.
    """

    chain_stops: bool = False


@dataclass(slots=True, order=True)
class _Reply:
    end_s: float
    start_s: float = field(compare=False)
    data: bytes = field(compare=False)
    uninvited: bool = field(compare=False)


class Wire:
    """A half-duplex wire: carries packets at their speed, with faults by seeded chance."""

    def __init__(self, faults: Iterable[Fault], seed: int) -> None:
        """Make an idle wire; only the faults that hit packets count here.

        host_until_s, until_s: when the computer's, and the servos', last byte is over.
        """
        self.counts = WireCounts()
        self.host_until_s = 0.0
        self.until_s = 0.0
        self._on_replies = [fault for fault in faults if fault.kind in ON_REPLIES]
        self._on_instructions = [fault for fault in faults if fault.kind in ON_INSTRUCTIONS]
        self._rng = random.Random(seed)
        self._out: list[_Reply] = []
        self._disturbed = False  # since the last instruction; later replies are pushed back by it

    @property
    def next_delivery_s(self) -> float:
        """The time in s of the next bytes to the computer; infinity: none are under way."""
        return self._out[0].end_s if self._out else float("inf")

    def deliver(self, now_s: float) -> bytes:
        """Return and remove the bytes that have reached the computer by `now_s`; b"": none."""
        n = bisect_right(self._out, now_s, key=lambda reply: reply.end_s)
        arrived = b"".join(reply.data for reply in self._out[:n])
        del self._out[:n]
        return arrived

    def clear(self) -> None:
        """Drop the bytes under way to the computer."""
        self._out.clear()

    def host_speaks(self, data: bytes, now_s: float, byte_s: float) -> tuple[bytes, float]:
        """Send the computer's bytes; return those that servos receive, and when the first is sent.

        byte_s: seconds a byte. Replies that are on the wire at that time are destroyed, and
        counted. Faults may lose or damage the computer's bytes.
        """
        start_s = max(now_s, self.host_until_s)
        self._disturbed = False
        self.host_until_s = start_s + len(data) * byte_s
        hit = [
            r for r in self._out if r.start_s < self.host_until_s and start_s < r.end_s - _SAME_S
        ]
        self.counts.contention += any(not reply.uninvited for reply in hit)
        for reply in hit:
            reply.data = b"\x00" * len(reply.data)
        for fault in self._on_instructions:
            if fault.hits(-1, now_s, self._rng):
                data = b"" if fault.kind == "drop_instruction" else self._flip(data, 0, len(data))
        return data, start_s

    def say(
        self,
        servo: SimulatedServo,
        replied_id: int,
        answer: tuple[int, bytes],
        after_s: float,
        byte_s: float,
    ) -> None:
        """Send one status packet of a servo after its return delay, with faults by chance.

        replied_id: the id in the packet. answer: (error, data). after_s: when the delay begins.
        byte_s: seconds a byte.
        """
        start_s = after_s + servo.return_delay_s
        error, data = answer
        raw = status(replied_id, error, data)
        # uninvited: a fault made the packet late, double or noise: the computer cannot foresee it
        times, uninvited = 1, False
        for fault in self._on_replies:
            if not fault.hits(servo.index, after_s, self._rng):
                continue
            kind = fault.kind
            uninvited |= kind in ("late_reply", "babble", "echo")
            if kind == "drop_reply":
                self.until_s = max(self.until_s, start_s + len(raw) * byte_s)
                return
            if kind == "corrupt_reply":
                raw = self._flip(raw, 0, len(raw))
            elif kind == "truncate_reply":
                raw = raw[: self._rng.randrange(1, len(raw))]
            elif kind == "duplicate_reply":
                times = 2
            elif kind == "late_reply":
                start_s += fault.amount
            elif kind == "wrong_id":
                raw = status((replied_id + 1) % 253, error, data)
            elif kind == "error_reply":
                raw = status(replied_id, int(fault.amount) or 1, b"")
            elif kind == "babble":
                raw += self._rng.randbytes(int(fault.amount) or 8)
            elif kind == "echo":
                raw = _ECHO + raw
        for n in range(times):
            self._queue(raw, start_s, byte_s, uninvited=uninvited or n > 0 or self._disturbed)
            self._disturbed = self._disturbed or uninvited or n > 0
            start_s = max(start_s, self.until_s)

    def swallows(self, servo: SimulatedServo) -> bool:
        """Return whether a fault, by chance, keeps a servo's part of a fast read's frame away.

        Kinds that lose, delay or cut a reply do.
        """
        return any(
            fault.kind in ("drop_reply", "late_reply", "truncate_reply")
            and fault.hits(servo.index, self.until_s, self._rng)
            for fault in self._on_replies
        )

    def say_together(
        self,
        replies: list[tuple[SimulatedServo, int, bytes]],
        missing: list[int],
        after_s: float,
        byte_s: float,
    ) -> None:
        """Send one frame with many servos' data, cut off where a silent servo's data would be.

        replies: (servo, error, data). missing: the number of data bytes of each silent servo and of
        those after it. after_s: when the return delay begins. byte_s: seconds a byte.
        """
        blocks = [(servo.servo_id, error, data) for servo, error, data in replies]
        # The header's length counts the silent servos' blocks, which are then cut off.
        frame = fast_status([*blocks, *((0, 0, bytes(size)) for size in missing)])
        frame = frame[: len(frame) - sum(size + 4 for size in missing)]
        for fault in self._on_replies:
            at = 8  # where the first servo's block begins
            for servo, _, data in replies:
                if fault.kind == "corrupt_reply" and fault.hits(servo.index, after_s, self._rng):
                    frame = self._flip(frame, at, len(data) + 4)
                at += len(data) + 4
        self._queue(frame, after_s + replies[0][0].return_delay_s, byte_s)

    def _flip(self, raw: bytes, start: int, size: int) -> bytes:
        at = start + self._rng.randrange(size) if size else 0
        if at >= len(raw):
            return raw
        return raw[:at] + bytes((raw[at] ^ 1 << self._rng.randrange(8),)) + raw[at + 1 :]

    def _queue(self, raw: bytes, start_s: float, byte_s: float, *, uninvited: bool = False) -> None:
        """Put the bytes `raw` on the wire at `start_s`; they are spoilt where two senders overlap.

        uninvited: whether a fault made the bytes late, double or noise.
        """
        end_s = start_s + len(raw) * byte_s
        # Two servos at once: one spoilt packet takes the place of both.
        for other in self._out:
            if other.start_s < end_s - _SAME_S and start_s < other.end_s - _SAME_S:
                self.counts.contention += not (uninvited or other.uninvited)
                n = min(len(raw), len(other.data))
                mixed = bytes(a & b for a, b in zip(raw, other.data, strict=False))
                # Two transmitters are never in step: bits are lost even where both say the same.
                raw = mixed[:-1] + bytes(each ^ 0xFF for each in mixed[-1:]) + raw[n:]
                other.data = b""
        if self.host_until_s > start_s + _SAME_S:  # the computer is still sending
            self.counts.contention += 1
            raw = b"\x00" * len(raw)
        self.until_s = max(self.until_s, end_s)
        insort(self._out, _Reply(end_s, start_s, raw, uninvited))
