"""What every servo bus answers to, what it reports, and what can go wrong.

The exceptions::

    BusError
    ├── PortError       nobody can be talked to
    │   └── PortGone    the port was there and is not any more; it may come back
    └── ServoError      one servo cannot do what is asked of it

Example scenarios: the adapter is unplugged, its port is held by another program or not permitted,
or the bus is used outside its `with` block (PortError); the plug is pulled in mid-sentence
(PortGone); a servo stands outside its own range and
refuses the goal that would hold it there (ServoError).

What a single servo reports in passing (a refused goal, a lost answer) is data in `Readings`, not an
exception: nine servos go on when the tenth has trouble.
"""

from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.health import Feedback, Health


class BusError(Exception):
    """The servos cannot be moved or read."""


class PortError(BusError):
    """The way to all servos is closed: absent, busy, not permitted, gone, or not yet opened."""


class PortGone(PortError):  # noqa: N818 - a state of the port, as PortError's other cases are
    """The port was open and has failed: unplugged, or reset by the computer."""


class ServoError(BusError):
    """One servo does not do what is asked of it."""


@dataclass(frozen=True, slots=True)
class Readings:
    """What the servos said. Every array is (n_servos,), in the order of the face's servo names.

    positions_deg: where each joint stands; NaN for a servo that has never answered.
    goals_deg: where each servo is trying to be, or would with torque on.
    torque_on: whether the servo holds its goal by force.
    errors: number in the last status packet, 0 = none;
        https://emanual.robotis.com/docs/en/dxl/protocol2/#error
    age_s: how old each servo's part is; 0 = asked and answered just now, infinity = never.
    """

    time_s: float
    positions_deg: NDArray[np.float64]
    goals_deg: NDArray[np.float64]
    torque_on: NDArray[np.bool_]
    errors: NDArray[np.uint8]
    age_s: NDArray[np.float64]

    @property
    def missing(self) -> NDArray[np.bool_]:
        """Which servos did not answer this time, (n_servos,)."""
        return self.age_s > 0.0


class ServoBus(Protocol):
    """All servos of one face, spoken to as one, in joint degrees.

    Use it as a context manager: it holds its port from `__enter__` to `__exit__`, and leaving
    always switches torque off first. Every method raises PortError when the port fails.
    """

    def set_torque(self, on: bool) -> None:
        """Hold goals by force, or let every joint go limp.

        Switching on moves a servo to its last goal; write the present position before.
        """

    def write_positions(self, positions_deg: NDArray[np.float64]) -> None:
        """Give every servo its next goal, (n_servos,); returns before they arrive.

        A servo keeps its old goal when the new one lies outside its own range.
        Raises ValueError for any other shape.
        """

    def read(self) -> Readings:
        """Ask every servo where it stands, where it is going, and whether it holds."""

    def feedback(self) -> Feedback:
        """Ask every servo where it stands: the short question of every tick."""

    def look_after(self) -> Health:
        """Ask one servo, the next in turn, how it is; what is known of all."""

    def wake(self, index: int) -> bool:
        """Let one limp servo hold the place where it stands; whether it now does."""

    def relax(self, index: int) -> None:
        """Let one servo go limp."""

    def reboot(self, index: int) -> None:
        """Restart one servo: clears its hardware error; it comes back limp."""

    def reopen(self) -> None:
        """Open the port again after PortGone; all servos are limp or stopped by themselves."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *exc: object) -> None: ...
