"""Servo ownership: each servo has one owner at a time, lips, expression, idle or neutral."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array

Indices = NDArray[np.intp]

#: A servo goes over from one owner to the next in this time: slower than speech, so that no
#: hand-over looks like a word, and done within a pause of 300 ms.
HANDOVER_S = 0.3
#: Steepest slope of the way over, 3 u^2 - 2 u^3, in shares of the way per HANDOVER_S.
STEEPEST = 1.5


class Layer(IntEnum):
    """The layers that may move a servo; of all that claim one, the highest owns it."""

    NEUTRAL = 0
    IDLE = 1
    EXPRESSION = 2
    LIPS = 3


@dataclass(frozen=True, slots=True)
class Claim:
    """The goals of one layer: `positions_deg` (k,) for the servos numbered `servos` (k,)."""

    layer: Layer
    servos: Indices
    positions_deg: Array


class ServoLayers:
    """A combiner of the claims of all layers into one pose each period."""

    def __init__(self, servo_names: Sequence[str], neutral_deg: Array, period_s: float) -> None:
        """Start without owners.

        neutral_deg: (n_servos,), the goals of servos that no layer claims. period_s: seconds from
        one pose to the next.
        """
        self.servo_names = tuple(servo_names)
        self._neutral_deg = neutral_deg
        self._step = period_s / HANDOVER_S
        self._owners = np.full(len(self.servo_names), -1)
        self._shown_deg = neutral_deg
        # The goal at which a servo's newest owner took over, and the share of the way done since.
        self._start_deg = neutral_deg
        self._progress = np.ones(len(self.servo_names))

    def indices(self, names: Sequence[str]) -> Indices:
        """Return the numbers of the servos `names`. Raises ValueError for an unknown name."""
        for name in names:
            if name not in self.servo_names:
                raise ValueError(f"no servo {name!r}; this face has {', '.join(self.servo_names)}")
        return np.array([self.servo_names.index(name) for name in names], dtype=np.intp)

    @property
    def owners(self) -> Mapping[str, Layer]:
        """The layer that owns each servo, by the servo's name; empty before the first pose."""
        if (self._owners < 0).any():
            return {}
        owners = (Layer(int(owner)) for owner in self._owners)
        return dict(zip(self.servo_names, owners, strict=True))

    def compose(self, claims: Sequence[Claim]) -> Array:
        """Return each servo's goal: its owner's, or during a hand-over one on the way to that goal.

        Of all layers that claim a servo the highest owns it. Goals of the first call are returned
        as they are. Later a new owner starts from the servo's last goal, and controls the servo
        fully after HANDOVER_S.

        Parameters
        ----------
        claims : Sequence[Claim]
            Servos, goals and layer each.

        Returns
        -------
        Array
            (n_servos,) degrees.
        """
        # Higher layers overwrite lower ones.
        goals_deg = self._neutral_deg.copy()
        owners = np.full(len(self.servo_names), int(Layer.NEUTRAL))
        for claim in sorted(claims, key=lambda claim: claim.layer):
            goals_deg[claim.servos] = claim.positions_deg
            owners[claim.servos] = int(claim.layer)
        is_new = (owners != self._owners) & (self._owners >= 0)
        self._owners = owners
        self._start_deg = np.where(is_new, self._shown_deg, self._start_deg)
        self._progress = np.where(is_new, 0.0, self._progress)
        under_way = self._progress < 1.0
        if under_way.any():
            self._progress = np.minimum(1.0, self._progress + self._step)
            # Smooth step, 3 u^2 - 2 u^3, from the goal at the hand-over to the owner's present one.
            way_left = 1.0 - self._progress**2 * (3.0 - 2.0 * self._progress)
            handed_deg = goals_deg + way_left * (self._start_deg - goals_deg)
            goals_deg = np.where(under_way, handed_deg, goals_deg)
        self._shown_deg = goals_deg
        return goals_deg
