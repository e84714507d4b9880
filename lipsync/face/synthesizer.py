"""What every synthesiser of mouth motion is to those who drive it."""

from typing import Protocol

from lipsync.face.frame import Frame
from lipsync.phonemes import PhonemeEvent, PhonemeUpdate


class Synthesizer(Protocol):
    """Phonemes in, frames out. What wraps a synthesiser is one itself."""

    @property
    def phonemes_planned(self) -> int:
        """How many phonemes have moved the mouth."""

    @property
    def lookahead_s(self) -> float:
        """How much sound after an instant must have been heard before its frame is asked for."""

    def reset(self) -> None:
        """Forget everything; the mouth is closed and the stream begins anew at sound time 0."""

    def push(self, update: PhonemeUpdate) -> None:
        """Take a revision of the phonemes; what has been shown stays as it is."""

    def frame_at(self, time_s: float) -> Frame:
        """The frame at a sound time; the same time gives the same frame.

        Times ascend, but for a step back of half a second at most.
        """

    def event_at(self, time_s: float) -> PhonemeEvent | None:
        """The phoneme believed at a time, for displays."""
