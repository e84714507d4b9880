"""What can go wrong with a servo bus.

The exceptions::

    BusError
    ├── PortError       the port, or every servo at it, cannot be reached
    │   └── PortGone    the port was there and is not any more; it may come back
    └── ServoError      one servo cannot do what was ordered

Example scenarios: the adapter is unplugged, its port is held by another program or not permitted,
or the bus is used outside its `with` block (PortError); the plug is pulled in mid-sentence
(PortGone); a servo stands outside its own range and
refuses the goal that would hold it there (ServoError).
"""


class BusError(Exception):
    """The servos cannot be moved or read."""


class PortError(BusError):
    """The way to all servos is closed: absent, busy, not permitted, gone, or not yet opened."""


class PortGone(PortError):  # noqa: N818 - a state of the port, as PortError's other cases are
    """The port was open and has failed: unplugged, or reset by the computer."""


class ServoError(BusError):
    """One servo does not do what was ordered."""
