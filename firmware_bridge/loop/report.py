"""The settings of a bridge, and its report of each tick."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.bus import Array
from firmware_bridge.gate.limits import PreventRule
from firmware_bridge.gate.ramp import StaleLevel, StaleRule
from firmware_bridge.gate.tracking import TrackingRule


@dataclass(frozen=True, slots=True)
class BridgeSettings:
    """The rate and rules of a servo loop (`Bridge`), and how its servos are started.

    rate_hz: nominal rate of `Bridge.tick`. stale: what happens without targets. tracking: when a
    servo counts as not following. prevent: what joints must not do together. tolerant:
    `Bridge.start` leaves it to the ticks to enable the servos that can hold; otherwise all or none.
    dry_run: servos are read and supervised, but get neither torque nor goals. given_up: reason by
    index, of servos that an earlier process of this face gave up. switched_off: indices of servos
    that a person switched off in an earlier process.
    """

    rate_hz: float
    stale: StaleRule = field(default_factory=StaleRule)
    tracking: TrackingRule = field(default_factory=TrackingRule)
    prevent: Sequence[PreventRule] = ()
    tolerant: bool = False
    dry_run: bool = False
    given_up: Mapping[int, str] = field(default_factory=dict)
    switched_off: Collection[int] = ()

    @property
    def period_s(self) -> float:
        """Seconds from one tick to the next."""
        return 1.0 / self.rate_hz


@dataclass(frozen=True, slots=True)
class TickReport:
    """The record of one tick: goals wanted and sent, limits hit. Every array is (n_servos,).

    wanted_deg are the goals before the last gate; sent_deg those after it. Only servos that are
    driven get them. torque_on: as of `KnownTorque.any_on`. target_age_s counts from the newest
    target due, or from the start of the face when that is later. late is how many ticks were missed
    before this tick.
    """

    time_s: float
    late: int
    wanted_deg: Array
    sent_deg: Array
    target_age_s: float
    stale: StaleLevel
    torque_on: bool | None
    range_hits: NDArray[np.bool_]
    rate_hits: NDArray[np.bool_]
    rejected: NDArray[np.bool_]
