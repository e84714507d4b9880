"""The interface of an open port to servos, whatever carries the bytes."""

from typing import Protocol, runtime_checkable

from firmware_bridge.clock import Clock


@runtime_checkable
class Transport(Protocol):
    """An open port to servos. Every method raises PortError when the port is gone."""

    @property
    def clock(self) -> Clock:
        """The clock that deadlines refer to."""

    @property
    def baud_rate(self) -> int:
        """Bits per second on the wire."""

    @baud_rate.setter
    def baud_rate(self, baud_rate: int) -> None: ...

    def write(self, data: bytes) -> None:
        """Send all bytes; return before they are on the wire."""

    def read(self, deadline_s: float) -> bytes:
        """Return the bytes that arrive next, by `deadline_s` at the latest; b"": none arrived."""

    def discard_input(self) -> bytes:
        """Return and remove the bytes that have arrived, without waiting; b"": none."""

    def close(self) -> None:
        """Close the port; safe to call twice."""
