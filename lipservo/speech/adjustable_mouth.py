"""What may be changed of the mouth's motion while it runs, and the gain of an excited voice."""

from collections.abc import Mapping
from typing import Final

from lipsync.face.synthesizer import Synthesizer
from lipsync.motion.live_synthesizer import STRONGEST, FinishedSynthesizer

#: The gain is followed so often, and once it is so far from the one that is in force: arousal
#: takes half a second to rise, and each change is eased over 0.3 s.
_EVERY_S: Final = 0.5
_SMALLEST_CHANGE: Final = 0.02


class AdjustableMouth:
    """Strength, and what else the strategy in use lets its user set.

    Closures lie outside of the strength (`FinishedSynthesizer`): a gain never opens them.
    """

    def __init__(self, synthesizer: Synthesizer) -> None:
        self._live = synthesizer if isinstance(synthesizer, FinishedSynthesizer) else None
        self._strength = 1.0 if self._live is None else self._live.strength
        self._gain = 1.0
        self._due_s = 0.0

    def change(self, settings: Mapping[str, float]) -> None:
        """Take what was set, by name, eased in."""
        if self._live is None:
            return
        if "strength" in settings and settings["strength"] != self._strength:
            self._strength = settings["strength"]
            self._set_strength()
        for name in self._live.adjustable & settings.keys() - {"strength"}:
            self._live.adjust(name, settings[name])

    def follow(self, now_s: float, gain: float) -> None:
        """Move so much livelier, at monotonic `now_s`."""
        if now_s < self._due_s or abs(gain - self._gain) < _SMALLEST_CHANGE:
            return
        self._due_s = now_s + _EVERY_S
        self._gain = gain
        self._set_strength()

    def _set_strength(self) -> None:
        if self._live is not None:
            self._live.adjust("strength", min(STRONGEST, self._strength * self._gain))
