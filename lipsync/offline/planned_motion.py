"""Motion that is known before it is shown, as a synthesiser, so that others can wrap it."""

import math

import numpy as np
from scipy.interpolate import CubicSpline

from lipsync.arrays import Array
from lipsync.expectation.context import PhonemeTrack, track_of
from lipsync.face.frame import Frame
from lipsync.phonemes import PhonemeEvent, PhonemeUpdate
from lipsync.timeline import PhonemeTimeline


class PlannedMotion:
    """Faces at even times with a cubic spline through them, and the phonemes they are of.

    faces: (n, n_components), the first at sound time 0; before and after it is the nearest of them.
    """

    def __init__(
        self, faces: Array, frame_rate_hz: float, events: tuple[PhonemeEvent, ...]
    ) -> None:
        self._last_s = (len(faces) - 1) / frame_rate_hz
        times_s = np.arange(len(faces)) / frame_rate_hz
        self._spline = CubicSpline(times_s, faces) if len(faces) > 1 else None
        self._faces = faces
        self._timeline = PhonemeTimeline(math.inf)
        self._timeline.apply(PhonemeUpdate(0.0, math.inf, math.inf, events))
        self._track = track_of(events)

    @property
    def phonemes_planned(self) -> int:
        """All of them."""
        return len(self._timeline.events)

    @property
    def lookahead_s(self) -> float:
        """Everything is heard beforehand."""
        return 0.0

    @property
    def track(self) -> PhonemeTrack:
        """The phonemes of the whole line, end to end."""
        return self._track

    def reset(self) -> None:
        """Nothing to forget: the line stays."""

    def push(self, update: PhonemeUpdate) -> None:
        """A line that is planned learns nothing new; raises ValueError."""
        raise ValueError(f"the line is planned; nothing can be revised ({update})")

    def frame_at(self, time_s: float) -> Frame:
        """The frame at a sound time, in any order of times."""
        at_s = min(max(time_s, 0.0), self._last_s)
        face = self._faces[0] if self._spline is None else self._spline(at_s)
        return Frame(time_s, np.asarray(face))

    def event_at(self, time_s: float) -> PhonemeEvent | None:
        """The phoneme of a time."""
        return self._timeline.event_at(time_s)
