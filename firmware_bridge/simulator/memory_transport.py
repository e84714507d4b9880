"""A simulated chain as a port, in memory and on any clock: an hour of bus in a blink."""

from collections.abc import Callable

from firmware_bridge.bus import PortGone
from firmware_bridge.clock import Clock
from firmware_bridge.simulator.chain import SimulatedChain


class MemoryTransport:
    """A `Transport` whose other end is a chain. `tap` sees every write, as (time_s, bytes)."""

    def __init__(
        self,
        chain: SimulatedChain,
        clock: Clock,
        baud_rate: int = 1_000_000,
        tap: Callable[[float, bytes], None] | None = None,
    ) -> None:
        """Raises PortGone while the chain is unplugged, as opening its port would."""
        self._chain = chain
        self._clock = clock
        self.baud_rate = baud_rate
        self._tap = tap
        self._closed = False
        self._check()

    @property
    def clock(self) -> Clock:
        """The clock it was given."""
        return self._clock

    def write(self, data: bytes) -> None:
        """Put bytes on the simulated wire."""
        self._check()
        if self._tap is not None:
            self._tap(self._clock.now(), data)
        self._chain.receive(data, self._clock.now(), self.baud_rate)

    def read(self, deadline_s: float) -> bytes:
        """Jump to the next delivery or to the deadline, whichever comes first."""
        self._check()
        self._clock.sleep_until(min(self._chain.next_delivery_s, deadline_s))
        data = self._chain.deliver(self._clock.now())
        if not data:
            self._clock.sleep_until(deadline_s)
        return data

    def discard_input(self) -> bytes:
        """What has been delivered by now."""
        self._check()
        return self._chain.deliver(self._clock.now())

    def close(self) -> None:
        """Forget the chain's pending bytes."""
        if not self._closed:
            self._closed = True
            self._chain.deliver(float("inf"))

    def _check(self) -> None:
        self._chain.advance(self._clock.now())
        if self._closed or not self._chain.plugged:
            self._closed = True
            raise PortGone("the simulated port is gone; plug the chain in again")
