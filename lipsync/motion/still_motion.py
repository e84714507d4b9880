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
    """A `Synthesizer` that keeps the mouth at rest and only records and counts phonemes."""

    def __init__(self, rest: Array) -> None:
        """Create the motion. rest: (n_components,) coefficients of a face at rest."""
        self._rest = np.array(rest, dtype=np.float64)
        self.reset()

    @property
    def phonemes_planned(self) -> int:
        """The number of phonemes, silences not counted, that `frame_at` has reached so far."""
        return self._n_shown

    @property
    def lookahead_s(self) -> float:
        """Seconds of sound that the loudspeaker buffers, 0.2; no recognition needs them."""
        return HELD_S

    def reset(self) -> None:
        """Forget all phonemes and set their count to 0."""
        self._timeline = PhonemeTimeline()
        self._n_shown = 0
        self._newest_s = -1.0

    def push(self, update: PhonemeUpdate) -> None:
        """Add the phonemes of an update to the timeline, for displays and for the count."""
        self._timeline.apply(update)

    def frame_at(self, time_s: float) -> Frame:
        """Return a frame with the mouth at rest; count the phoneme at `time_s` if it is new."""
        event = self._timeline.event_at(time_s)
        if event is not None and event.phoneme != SILENCE and event.start_s > self._newest_s:
            self._newest_s = event.start_s
            self._n_shown += 1
        return Frame(time_s, self._rest)

    def window_after(self, frame: Frame) -> FaceWindow:
        """Return a face window that contains only the given frame."""
        return frame_alone(frame)

    def event_at(self, time_s: float) -> PhonemeEvent | None:
        """Return the phoneme at a sound time, or None where none is known."""
        return self._timeline.event_at(time_s)
