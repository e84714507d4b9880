"""A mouth that stays at rest unless a performance (a rendered line) plays: without a recogniser."""

import numpy as np

from lipsync.arrays import Array
from lipsync.face.frame import FaceWindow, Frame, frame_alone
from lipsync.phonemes import SILENCE, PhonemeEvent, PhonemeUpdate
from lipsync.timeline import PhonemeTimeline

#: The loudspeaker buffers so much sound ahead of a frame: else each tick that is late, and each of
#: a face of 30 ticks a second, is a gap in the sound. It is as much as a recogniser and the default
#: look-ahead take.
HELD_S = 0.2


class StillMotion:
    """A `lipsync.face.frame.Synthesizer` that keeps the mouth at rest and only counts phonemes."""

    def __init__(self, rest: Array) -> None:
        """Create the motion; `rest` is the coefficients (n_components,) of the face at rest."""
        self._rest = np.array(rest, dtype=np.float64)
        self.reset()

    @property
    def phonemes_planned(self) -> int:
        """The number of phonemes, silences not counted, that `frame_at` has reached so far."""
        return self._n_shown

    @property
    def lookahead_s(self) -> float:
        """Seconds of sound that the loudspeaker buffers ahead of a frame, always 0.2."""
        return HELD_S

    def reset(self) -> None:
        """Forget all phonemes, set their count to 0; a new stream begins at sound time 0."""
        self._timeline = PhonemeTimeline()
        self._n_shown = 0
        self._newest_s = -1.0

    def push(self, update: PhonemeUpdate) -> None:
        """Apply the phonemes of an update to the timeline that `event_at` and the count read."""
        self._timeline.apply(update)

    def frame_at(self, time_s: float) -> Frame:
        """Return the face at rest for sound time `time_s`; count each phoneme reached once."""
        event = self._timeline.event_at(time_s)
        if event is not None and event.phoneme != SILENCE and event.start_s > self._newest_s:
            self._newest_s = event.start_s
            self._n_shown += 1
        return Frame(time_s, self._rest)

    def window_after(self, frame: Frame) -> FaceWindow:
        """Return a face window of the given frame alone, as the mouth does not move."""
        return frame_alone(frame)

    def event_at(self, time_s: float) -> PhonemeEvent | None:
        """Return the phoneme at sound time `time_s`, or None where no phoneme is known."""
        return self._timeline.event_at(time_s)
