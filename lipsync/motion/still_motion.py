"""A mouth that does not move: a performance is played on it where no recogniser listens."""

import numpy as np

from lipsync.arrays import Array
from lipsync.face.frame import FaceWindow, Frame, frame_alone
from lipsync.phonemes import SILENCE, PhonemeEvent, PhonemeUpdate
from lipsync.timeline import PhonemeTimeline

#: The face waits so long for the loudspeaker, which holds as much sound meanwhile: else each tick
#: that is late, and each of a face of 30 ticks a second, is a gap in the sound. As much as a
#: recogniser and the default look-ahead take, with which all else is played.
HELD_S = 0.2


class StillMotion:
    """A `Synthesizer` that keeps the mouth at rest; phonemes are taken and counted as ever."""

    def __init__(self, rest: Array) -> None:
        """rest: the face (n_components,) of a mouth at rest."""
        self._rest = np.array(rest, dtype=np.float64)
        self.reset()

    @property
    def phonemes_planned(self) -> int:
        """The number of phonemes shown so far, without silences."""
        return self._n_shown

    @property
    def lookahead_s(self) -> float:
        """Nothing must be heard for its sake: it is sound that the loudspeaker holds."""
        return HELD_S

    def reset(self) -> None:
        """Forget all phonemes."""
        self._timeline = PhonemeTimeline()
        self._n_shown = 0
        self._newest_s = -1.0

    def push(self, update: PhonemeUpdate) -> None:
        """Take the phonemes, for displays and counts."""
        self._timeline.apply(update)

    def frame_at(self, time_s: float) -> Frame:
        """Return the mouth at rest."""
        event = self._timeline.event_at(time_s)
        if event is not None and event.phoneme != SILENCE and event.start_s > self._newest_s:
            self._newest_s = event.start_s
            self._n_shown += 1
        return Frame(time_s, self._rest)

    def window_after(self, frame: Frame) -> FaceWindow:
        """Return a window of the frame alone."""
        return frame_alone(frame)

    def event_at(self, time_s: float) -> PhonemeEvent | None:
        """The phoneme of a sound time."""
        return self._timeline.event_at(time_s)
