"""The exceptions of a servo bus.

Their hierarchy::

    BusError
    ├── PortError       the port, or every servo at it, cannot be reached
    │   └── PortGone    the port was open and has failed; it may come back
    └── ServoError      one servo cannot do what was ordered

Examples: the adapter is unplugged, its port is held by another program or not permitted, or the bus
is used outside its `with` block (PortError); the plug is pulled in mid-sentence (PortGone); a servo
is outside its own range and refuses the goal that would hold it there (ServoError).
"""


class BusError(Exception):
    """Raised when the servos cannot be moved or read."""


class PortError(BusError):
    """Raised when the servos' port is absent, busy, not permitted, gone, or not yet opened."""


class RateError(PortError):
    """Error of an adapter that cannot do a baud rate; the port stays open at the rate before."""


class PortGone(PortError):  # noqa: N818 - a state of the port, as PortError's other cases are
    """Raised when an open port has failed: unplugged, or reset by the computer."""


class ServoError(BusError):
    """Raised when one servo does not do what was ordered."""
