"""What a bridge is told of its face."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from firmware_bridge.gate.coupling import PreventRule
from firmware_bridge.gate.limits import StaleRule
from firmware_bridge.gate.tracking import TrackingRule


@dataclass(frozen=True, slots=True)
class BridgeSettings:
    """Rate, rules, and how a face is brought up.

    rate_hz: nominal rate of `Bridge.tick`. stale: what happens without targets. tracking: when a
    servo counts as not following. prevent: what joints must not do together.
    tolerant: `Bridge.start` leaves it to the ticks to enable whoever can hold; not all or none.
    dry_run: servos are read and supervised, but get neither torque nor goals.
    given_up: reason by index, of servos that an earlier process of this face gave up.
    switched_off: by index, those that a person switched off there.
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
        """From one tick to the next."""
        return 1.0 / self.rate_hz
