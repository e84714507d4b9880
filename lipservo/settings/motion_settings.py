"""`motion:` of a face YAML: how this face turns sound into motion by itself."""

from typing import Annotated, Self

from pydantic import model_validator

from lipservo.settings.motion_names import (
    DEFAULT_STRATEGY,
    FARTHEST_LIP_GAP_OFFSET_MM,
    LONGEST_LOOKAHEAD_MS,
    ONLY_UNITS,
    SMOOTHEST,
    STRONGEST,
    STYLE_NAMES,
    STYLES_OF,
    Engine,
    Strategy,
)
from lipservo.settings.setting_types import Strict, Text, within


class MotionSettings(Strict):
    """Every one of them may be absent; the command line goes before it.

    weights: `default`, `grid`, or a file, from the folder of the YAML.
    """

    strategy: Strategy | None = None
    engine: Engine | None = None
    weights: Text | None = None
    lookahead_ms: Annotated[float, within(0.0, LONGEST_LOOKAHEAD_MS)] | None = None
    strength: Annotated[float, within(0.0, STRONGEST)] | None = None
    smoothness: Annotated[float, within(0.0, SMOOTHEST)] | None = None
    unit_share: Annotated[float, within(0.0, ONLY_UNITS)] | None = None
    lip_gap_offset_mm: (
        Annotated[float, within(-FARTHEST_LIP_GAP_OFFSET_MM, FARTHEST_LIP_GAP_OFFSET_MM)] | None
    ) = None

    @model_validator(mode="after")
    def _the_strategy_has_them(self) -> Self:
        strategy = self.strategy or DEFAULT_STRATEGY
        given = [name for name in STYLE_NAMES if getattr(self, name) is not None]
        ignored = [name for name in given if name not in STYLES_OF[strategy]]
        if ignored:
            raise ValueError(f"strategy {strategy} has no {', '.join(ignored)}; leave it out")
        return self
