"""A share of AnimPhos in the expected motion."""

from dataclasses import replace

from lipsync.face.frame import Frame
from lipsync.motion.eased_setting import EasedSetting
from lipsync.motion.tick_plan import TICK_S, tick_of
from lipsync.motion.unit_motion import UnitMotion
from lipsync.motion.wrapped_synthesizer import TrackedSynthesizer, WrappedSynthesizer


class MixingSynthesizer(WrappedSynthesizer):
    """The weighted mean of the frames inside and of AnimPhos; strength belongs outside of it."""

    def __init__(self, inner: TrackedSynthesizer, units: UnitMotion, unit_share: float) -> None:
        """unit_share: 0 leaves the frames inside as they are, 1 shows AnimPhos alone."""
        super().__init__(inner)
        self._units = units
        self._share = EasedSetting(unit_share, 1.0)
        self._newest_tick = -1

    def adjust_unit_share(self, unit_share: float) -> None:
        """Go over to another share, 0 to 1; what was shown stays as it is."""
        self._share.change(self._newest_tick * TICK_S, unit_share)

    def reset(self) -> None:
        """Forget everything but the share that was set last."""
        super().reset()
        self._units.reset()
        self._share.settle()
        self._newest_tick = -1

    def frame_at(self, time_s: float) -> Frame:
        """The frame inside, brought nearer to the AnimPhos."""
        frame = self._inner.frame_at(time_s)
        face = self._units.at(time_s, self.track)
        self._newest_tick = max(self._newest_tick, tick_of(time_s))
        share = self._share.at(time_s)
        if face is None or share == 0.0:
            return frame
        mixed = frame.coefficients + share * (face - frame.coefficients)
        return replace(frame, coefficients=mixed)
