"""A synthesiser around another one: what all such parts have in common."""

from typing import Protocol

from lipsync.expectation.context import PhonemeTrack
from lipsync.face.frame import Frame
from lipsync.face.synthesizer import Synthesizer
from lipsync.phonemes import PhonemeEvent, PhonemeUpdate


class TrackedSynthesizer(Synthesizer, Protocol):
    """A synthesiser whose phonemes can be seen by the parts around it."""

    @property
    def track(self) -> PhonemeTrack:
        """The phonemes as they are believed now, end to end."""


class WrappedSynthesizer:
    """Passes everything through to the synthesiser inside; a part overrides what it changes."""

    def __init__(self, inner: TrackedSynthesizer) -> None:
        self._inner = inner

    @property
    def phonemes_planned(self) -> int:
        """How many phonemes have moved the mouth."""
        return self._inner.phonemes_planned

    @property
    def lookahead_s(self) -> float:
        """How much sound after an instant must have been heard before its frame is asked for."""
        return self._inner.lookahead_s

    @property
    def track(self) -> PhonemeTrack:
        """The phonemes as they are believed now, end to end."""
        return self._inner.track

    def reset(self) -> None:
        """Forget everything; the mouth is closed and the stream begins anew at sound time 0."""
        self._inner.reset()

    def push(self, update: PhonemeUpdate) -> None:
        """Take a revision of the phonemes; what has been shown stays as it is."""
        self._inner.push(update)

    def frame_at(self, time_s: float) -> Frame:
        """The frame at sound time `time_s`; the same time gives the same frame."""
        return self._inner.frame_at(time_s)

    def event_at(self, time_s: float) -> PhonemeEvent | None:
        """The phoneme believed at a time, for displays."""
        return self._inner.event_at(time_s)
