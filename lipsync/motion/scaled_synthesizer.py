"""Strength: how far the mouth moves from rest, for any synthesiser."""

from dataclasses import replace

from lipsync.arrays import Array
from lipsync.face.frame import Frame
from lipsync.motion.eased_setting import EasedSetting
from lipsync.motion.tick_plan import TICK_S, tick_of
from lipsync.motion.wrapped_synthesizer import TrackedSynthesizer, WrappedSynthesizer


class ScaledSynthesizer(WrappedSynthesizer):
    """Multiplies the mouth's distance from rest; closures belong outside of it."""

    def __init__(
        self, inner: TrackedSynthesizer, rest: Array, strength: float, *, strongest: float
    ) -> None:
        """rest: (n_components,). strength: 0 keeps the mouth at rest, 1 changes nothing."""
        super().__init__(inner)
        self._rest = rest
        self._strength = EasedSetting(strength, strongest)
        self._newest_tick = -1

    def adjust_strength(self, strength: float) -> None:
        """Go over to another strength, 0 to the strongest; what was shown stays as it is."""
        self._strength.change(self._newest_tick * TICK_S, strength)

    def reset(self) -> None:
        """Forget everything but the strength that was set last."""
        super().reset()
        self._strength.settle()
        self._newest_tick = -1

    def frame_at(self, time_s: float) -> Frame:
        """The frame inside, its mouth brought nearer to rest or farther from it."""
        frame = self._inner.frame_at(time_s)
        self._newest_tick = max(self._newest_tick, tick_of(time_s))
        strength = self._strength.at(time_s)
        if strength == 1.0:
            return frame
        scaled = self._rest + strength * (frame.coefficients - self._rest)
        return replace(frame, coefficients=scaled)
