"""What people and programs may ask of an expression while a face runs: plain numbers by name."""

import math
from collections.abc import Mapping
from typing import Final

from firmware_bridge.process.command_queue import Setting
from lipservo.settings.expression_settings import LIVELIEST

#: Farther to the side than a person looks without turning round.
_FARTHEST_YAW_DEG: Final = 60.0
_FARTHEST_PITCH_DEG: Final = 40.0
_LONGEST_TAU_S: Final = 600.0
_SHORTEST_TAU_S: Final = 0.1
#: Monotonic seconds of a computer that runs for thirty years.
_LATEST_S: Final = 1e9


def expression_settings(amount: float) -> dict[str, Setting]:
    """What may be set, with its bounds.

    look_weight: 1 = look at (look_yaw_deg, look_pitch_deg), 0 = at nobody. The affect that a
    dialogue system wishes fades with affect_tau_s from monotonic affect_at_s on.
    """
    return {
        "expression": Setting(amount, 0.0, LIVELIEST),
        "look_weight": Setting(0.0, 0.0, 1.0),
        "look_yaw_deg": Setting(0.0, -_FARTHEST_YAW_DEG, _FARTHEST_YAW_DEG),
        "look_pitch_deg": Setting(0.0, -_FARTHEST_PITCH_DEG, _FARTHEST_PITCH_DEG),
        "affect_valence": Setting(0.0, -1.0, 1.0),
        "affect_arousal": Setting(0.0, -1.0, 1.0),
        "affect_tau_s": Setting(10.0, _SHORTEST_TAU_S, _LONGEST_TAU_S),
        "affect_at_s": Setting(0.0, 0.0, _LATEST_S),
    }


class ExpressionWishes:
    """The values that were set last."""

    #: Names of what is wished for the moment: no face has them as its way.
    PASSING: Final = frozenset(expression_settings(0.0)) - {"expression"}

    def __init__(self, amount: float) -> None:
        self._values = {name: each.value for name, each in expression_settings(amount).items()}

    def change(self, settings: Mapping[str, float]) -> bool:
        """Take those that are known here; whether any is another than before."""
        news = {
            name: value
            for name, value in settings.items()
            if name in self._values and value != self._values[name]
        }
        self._values.update(news)
        return bool(news)

    @property
    def values(self) -> dict[str, float]:
        """All of them, by name."""
        return dict(self._values)

    @property
    def amount(self) -> float:
        """How lively: 0 still, 1 as people are."""
        return self._values["expression"]

    @property
    def look_at_deg(self) -> tuple[float, float] | None:
        """(yaw, pitch) to look at; None: nobody is there."""
        if self._values["look_weight"] < 0.5:
            return None
        return self._values["look_yaw_deg"], self._values["look_pitch_deg"]

    def affect_at(self, now_s: float) -> tuple[float, float]:
        """(valence, arousal) that were set, as far as they have not faded by monotonic `now_s`."""
        values = self._values
        age_s = max(0.0, now_s - values["affect_at_s"])
        left = math.exp(-age_s / values["affect_tau_s"])
        return values["affect_valence"] * left, values["affect_arousal"] * left
