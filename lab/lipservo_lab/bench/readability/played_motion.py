"""Motion that is known beforehand, played as a synthesiser would."""

import numpy as np

from lipsync.arrays import Array
from lipsync.face.frame import Frame
from lipsync.phonemes import PhonemeEvent, PhonemeUpdate


class PlayedMotion:
    """A `Synthesizer` of given faces, between which it goes by straight lines."""

    lookahead_s = 0.0
    phonemes_planned = 0

    def __init__(self, times_s: Array, faces: Array) -> None:
        """times_s: (n,), ascending; faces: (n, n_components)."""
        self._times_s = times_s
        self._faces = faces

    def reset(self) -> None:
        """Nothing is remembered."""

    def push(self, update: PhonemeUpdate) -> None:
        """Phonemes change nothing."""

    def frame_at(self, time_s: float) -> Frame:
        """The face at a sound time; before and after all of them the first and the last."""
        columns = [np.interp(time_s, self._times_s, column) for column in self._faces.T]
        return Frame(time_s, np.array(columns))

    def event_at(self, time_s: float) -> PhonemeEvent | None:  # noqa: ARG002 - knows no phonemes
        """Nobody knows."""
        return None
