"""What the speech side asks of the servos, and how it reaches the bridge."""

from dataclasses import dataclass
from typing import Protocol

from firmware_bridge.arrays import Array


@dataclass(frozen=True, slots=True)
class ServoTargets:
    """Joint angles wanted at monotonic display time `time_s`.

    positions_deg: (n_servos,), in the order of the face's servo names, 0 = the joint's neutral.
    """

    time_s: float
    positions_deg: Array


class TargetChannel(Protocol):
    """Carries targets one way. Nobody ever blocks; the newest targets win."""

    def publish(self, targets: ServoTargets) -> None:
        """Hand over one target record."""

    def drain(self) -> list[ServoTargets]:
        """All records published since the last call that still matter, oldest first."""
