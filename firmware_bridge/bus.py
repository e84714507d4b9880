"""What every servo bus answers to, what it reports, and what can go wrong.

The exceptions::

    BusError
    ├── PortError     nobody can be talked to
    └── ServoError    one servo cannot do what is asked of it

Example scenarios: the adapter is unplugged, its port is held by another program or not permitted,
or the bus is used outside its `with` block (PortError); a servo stands outside its own range and
refuses the goal that would hold it there (ServoError).

What a single servo reports in passing (a refused goal, a lost answer) is data in `Readings`, not an
exception: nine servos go on when the tenth has trouble.
"""

from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray


class BusError(Exception):
    """The servos cannot be moved or read."""


class PortError(BusError):
    """The way to all servos is closed: absent, busy, not permitted, gone, or not yet opened."""


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
    """

    time_s: float
    positions_deg: NDArray[np.float64]
    goals_deg: NDArray[np.float64]
    torque_on: NDArray[np.bool_]
    errors: NDArray[np.uint8]


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
        """Ask every servo where it stands."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *exc: object) -> None: ...
