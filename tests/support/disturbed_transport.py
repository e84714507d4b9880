"""A port whose adapter echoes, delays, loses and invents bytes, in front of a simulated chain."""

import heapq

from firmware_bridge.dynamixel.wire.codec import Instruction


class DisturbedTransport:
    """A `Transport` in virtual time. What befalls a reply is drawn from `rng`.

    late: share of replies that come late_s later, whole; lost: share of replies, and of requests,
    that never arrive; stray: share of replies with noise before and after; echo: what is sent comes
    back; fast: whether servos know fast sync reads; latency_s: what every reply takes longer.
    """

    def __init__(
        self, chain, clock, rng, *, late=0.0, late_s=0.025, lost=0.0, stray=0.0, echo=False,
        fast=True, latency_s=0.0, baud_rate=1_000_000, sent=None,
    ):  # fmt: skip
        self.chain, self.clock, self.rng = chain, clock, rng
        self.late, self.late_s, self.lost, self.stray = late, late_s, lost, stray
        self.echo, self.fast, self.latency_s = echo, fast, latency_s
        self.baud_rate = baud_rate
        self.sent = [] if sent is None else sent
        self._on_the_way = []
        self._n = 0

    def write(self, data):
        now_s = self.clock.now()
        self.sent.append(data)
        self.chain.advance(now_s)
        if self.echo:
            self._queue(now_s + len(data) * 10.0 / self.baud_rate, data)
        if self.rng.random() < self.lost or (
            data[7] == Instruction.FAST_SYNC_READ and not self.fast
        ):
            return
        self.chain.receive(data, now_s, self.baud_rate)

    def read(self, deadline_s):
        while True:
            due_s = min(self._next_s(), self.chain.next_delivery_s)
            if due_s > deadline_s:
                self.clock.sleep_until(deadline_s)
                return b""
            self.clock.sleep_until(due_s)
            data = self.discard_input()
            if data:
                return data

    def discard_input(self):
        now_s = self.clock.now()
        self.chain.advance(now_s)
        while self.chain.next_delivery_s <= now_s:
            due_s = self.chain.next_delivery_s
            self._befall(due_s + self.latency_s, self.chain.deliver(due_s))
        arrived = b""
        while self._next_s() <= now_s:
            arrived += heapq.heappop(self._on_the_way)[2]
        return arrived

    def close(self):
        self._on_the_way.clear()

    def _befall(self, due_s, reply):
        rng = self.rng
        if rng.random() < self.lost:
            return
        if rng.random() < self.late:
            due_s += self.late_s * rng.uniform(0.9, 1.1)
        if rng.random() < self.stray:
            reply = rng.randbytes(rng.randrange(1, 9)) + reply + rng.randbytes(rng.randrange(1, 9))
        self._queue(due_s, reply)

    def _queue(self, due_s, data):
        self._n += 1
        heapq.heappush(self._on_the_way, (due_s, self._n, data))

    def _next_s(self):
        return self._on_the_way[0][0] if self._on_the_way else float("inf")
