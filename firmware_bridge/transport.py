"""An open port to servos, for any carrier of the bytes and any device at the other end."""

from typing import Protocol, runtime_checkable

from firmware_bridge.clock import Clock


@runtime_checkable
class Transport(Protocol):
    """An open port. Every method raises PortError when the port is gone."""

    @property
    def clock(self) -> Clock:
        """The clock of the deadlines."""

    @property
    def baud_rate(self) -> int:
        """Bits a second on the wire."""

    @baud_rate.setter
    def baud_rate(self, baud_rate: int) -> None: ...

    def write(self, data: bytes) -> None:
        """Send all of it; returns before it is on the wire."""

    def read(self, deadline_s: float) -> bytes:
        """What has arrived, at the latest at `deadline_s`; b"" when nothing has."""

    def discard_input(self) -> bytes:
        """Throw away what has arrived, without waiting, and return it."""

    def close(self) -> None:
        """Give the port back; safe to call twice."""
