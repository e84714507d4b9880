"""What every servo bus answers to, and what it reports; what can go wrong: `errors`.

What a single servo reports in passing (a refused goal, a lost answer) is data in `Readings`, not an
exception: nine servos go on when the tenth has trouble.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.arrays import Array
from firmware_bridge.errors import BusError, PortError, PortGone, ServoError
from firmware_bridge.health import Feedback, Health

__all__ = ["BusError", "PortError", "PortGone", "Readings", "ServoBus", "ServoError"]


@dataclass(frozen=True, slots=True)
class Readings:
    """What the servos said. Every array is (n_servos,), in the order of the face's servo names.

    positions_deg: where each joint stands; NaN for a servo that has never answered.
    goals_deg: where each servo is trying to be, or would with torque on; NaN when it did not say.
    torque_on: whether the servo holds its goal by force.
    errors: number in the last status packet, 0 = none;
        https://emanual.robotis.com/docs/en/dxl/protocol2/#error
    age_s: how old each servo's part is; 0 = asked and answered just now, infinity = never.
    """

    time_s: float
    positions_deg: Array
    goals_deg: Array
    torque_on: NDArray[np.bool_]
    errors: NDArray[np.uint8]
    age_s: Array

    @property
    def missing(self) -> NDArray[np.bool_]:
        """Which servos did not answer this time, (n_servos,)."""
        return self.age_s > 0.0


class ServoBus(Protocol):
    """All servos of one face, spoken to as one, in joint degrees.

    Use it as a context manager: it holds its port from `__enter__` to `__exit__`, and leaving
    first switches torque off on every servo that it was switched on for. Every method raises
    PortError when the port fails. Only `TorqueGate` calls `enable_torque`.
    """

    def write_positions(self, positions_deg: Array) -> None:
        """Give every servo its next goal, (n_servos,); returns before they arrive.

        A servo keeps its old goal when the new one lies outside its own range, or is NaN.
        Raises ValueError for any other shape.
        """

    def read(self) -> Readings:
        """Ask every servo where it stands, where it is going, and whether it holds."""

    def feedback(self) -> Feedback:
        """Ask every servo where it stands: the short question of every tick."""

    def remarks(self) -> Sequence[str]:
        """What is unusual about adapter and servos, in sentences for a log; they become more."""

    def look_after(self) -> Health:
        """Ask one servo, the next in turn, how it is; what is known of all."""

    def obstacle(self, index: int) -> str:
        """Why one servo cannot hold its place as the face's YAML says; empty: it can.

        Asks who it is, how it is set up, and where it stands; changes nothing.
        """

    def enable_torque(self, index: int) -> str:
        """Let one servo hold the place where it stands; why it does not, empty: it confirmed.

        The goal becomes the place first, so that nothing moves; speed and strength start low; the
        bus watchdog runs. A servo with an obstacle gets no torque.
        """

    def keep_torque(self, index: int) -> bool:
        """Let a servo that holds go on holding where it stands; whether it holds.

        Switches no torque on: after a lost connection, for a face frozen by a person.
        """

    def disable_torque(self, index: int) -> bool:
        """Let one servo go limp; whether it confirmed."""

    def disable_all(self) -> NDArray[np.bool_]:
        """Let every servo go limp now; which of them confirmed, (n_servos,)."""

    def reboot(self, index: int) -> None:
        """Restart one servo: clears its hardware error; it comes back limp."""

    def reopen(self) -> None:
        """Open the port again after it has failed. Asks no servo anything."""

    def __enter__(self) -> Self: ...

    def __exit__(self, *exc: object) -> None: ...
