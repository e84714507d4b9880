"""Rest: in a pause the mouth closes, whatever the synthesiser inside goes on doing."""

from dataclasses import replace

from lipsync.arrays import Array
from lipsync.expectation.context import context_at
from lipsync.face.frame import Frame
from lipsync.motion.amount import Amount
from lipsync.motion.rest_plan import AT_REST, planned_rest
from lipsync.motion.tick_plan import TICK_S, TickPlan
from lipsync.motion.wrapped_synthesizer import TrackedSynthesizer, WrappedSynthesizer


class RestingSynthesizer(WrappedSynthesizer):
    """Brings the mouth to rest in pauses, and back to the frames inside before they end."""

    def __init__(self, inner: TrackedSynthesizer, rest: Array, known_s: float) -> None:
        """rest: (n_components,). known_s: how far beyond its tick a decision may look, s."""
        super().__init__(inner)
        self._rest = rest
        self._known_s = known_s
        self._ticks = TickPlan(AT_REST)

    @property
    def is_resting(self) -> bool:
        """Whether the mouth is at rest, or on its way there, because nobody speaks."""
        return self._ticks.newest.goal == 1.0

    def reset(self) -> None:
        """Forget everything; the mouth is at rest and the stream begins anew at sound time 0."""
        super().reset()
        self._ticks = TickPlan(AT_REST)

    def frame_at(self, time_s: float) -> Frame:
        """The frame inside, its mouth at rest by as much as a pause asks for."""
        frame = self._inner.frame_at(time_s)
        rest = self._ticks.at(time_s, self._decide)
        if rest is None:
            return frame
        share = 1.0 - rest.smooth(time_s)
        return replace(frame, coefficients=self._rest + share * (frame.coefficients - self._rest))

    def _decide(self, time_s: float, last: Amount) -> Amount:
        context = context_at(self.track, time_s, time_s + self._known_s)
        return planned_rest(last, *context, time_s - TICK_S, self._known_s)
