"""A port whose adapter echoes, delays, loses and invents bytes, in front of a simulated chain."""

import heapq
import random
from dataclasses import dataclass

from firmware_bridge.clock import Clock
from firmware_bridge.dynamixel.wire.codec import BITS_PER_BYTE, Instruction
from firmware_bridge.simulator.chain import SimulatedChain


@dataclass(frozen=True, slots=True)
class Disturbance:
    """What adapter and wire do to packets; shares are of 1.

    late: share of replies that come late_s later (within a tenth of it), whole. lost: share of
    replies, and of requests, that never arrive. stray: share of replies with one to eight bytes of
    noise before and after. echo: what is sent comes back. fast_sync_read: whether servos know it.
    latency_s: what every reply takes longer.
    """

    late: float = 0.0
    late_s: float = 0.025
    lost: float = 0.0
    stray: float = 0.0
    echo: bool = False
    fast_sync_read: bool = True
    latency_s: float = 0.0


class DisturbedTransport:
    """A `Transport` in virtual time. What is done to a reply is drawn from `rng`.

    sent: every packet written so far, also those that got lost.
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
        unknown = data[7] == Instruction.FAST_SYNC_READ and not self.disturbance.fast_sync_read
        if self._rng.random() >= self.disturbance.lost and not unknown:
            self._chain.receive(data, now_s, self.baud_rate)

    def read(self, deadline_s: float) -> bytes:
        """Jump to the next arrival or to the deadline, whichever comes first."""
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
        """What has arrived by now."""
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
        rng, by = self._rng, self.disturbance
        if rng.random() < by.lost:
            return
        if rng.random() < by.late:
            due_s += by.late_s * rng.uniform(0.9, 1.1)
        if rng.random() < by.stray:
            reply = rng.randbytes(rng.randrange(1, 9)) + reply + rng.randbytes(rng.randrange(1, 9))
        self.queue(due_s, reply)

    def queue(self, due_s: float, data: bytes) -> None:
        """Let bytes arrive at `due_s`."""
        self._n += 1
        heapq.heappush(self._on_the_way, (due_s, self._n, data))

    def _next_s(self) -> float:
        return self._on_the_way[0][0] if self._on_the_way else float("inf")
