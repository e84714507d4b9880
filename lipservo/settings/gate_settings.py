"""What a face YAML may say about the last gate: rules between joints, silence, following."""

from collections.abc import Iterable, Mapping
from typing import Annotated, Self

from pydantic import model_validator

from lipservo.settings.setting_types import Factor, JointName, Seconds, Strict, Text, within


class PreventSettings(Strict):
    """Joints that must not go there together: the sum of factor x angle stays at most `above`."""

    joints: Mapping[JointName, Factor]
    above: Factor
    because: Text

    def factors(self, names: Iterable[str]) -> tuple[float, ...]:
        """One for each of these joints, 0 for one that has no part in the rule."""
        return tuple(self.joints.get(name, 0.0) for name in names)


class StaleSettings(Strict):
    """What happens when speech falls silent; seconds since the newest target."""

    hold_s: Seconds = 0.1
    neutral_s: Seconds = 1.0
    limp_s: Seconds = 5.0

    @model_validator(mode="after")
    def _the_times_rise(self) -> Self:
        if not self.hold_s < self.neutral_s <= self.limp_s:
            raise ValueError(
                f"needs hold_s < neutral_s <= limp_s, got {self.hold_s:g}, {self.neutral_s:g} "
                f"and {self.limp_s:g}"
            )
        return self


class TrackingSettings(Strict):
    """A servo so far from its goal for so long does not follow, and is let go.

    error_deg: None = by each joint's range (`firmware_bridge.gate.tracking`).
    """

    error_deg: Annotated[float, within(1.0, 360.0)] | None = None
    after_s: Annotated[float, within(0.1, 60.0)] = 0.5
