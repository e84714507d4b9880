"""Where streams of speech, and phonemes known of them, lie on the timeline of what is said."""

from collections import deque
from dataclasses import dataclass, field, replace
from typing import Final

from lipsync.audio.playout_stream import PlayoutStream
from lipsync.audio_block import BLOCK_S
from lipsync.phonemes import SILENCE, PhonemeEvent

#: Phonemes that were known beforehand are remembered so long after they were said: a recogniser
#: does not reach farther back.
_REMEMBERED_S: Final = 5.0

#: Goes on from the beginning of time: each stretch cuts its own part out of it.
_SILENCE: Final = (PhonemeEvent(SILENCE, 0.0, None),)

#: (start_s, end_s, events) on the timeline; an event may reach beyond the end, where it is cut off.
KnownStretch = tuple[float, float, tuple[PhonemeEvent, ...]]


@dataclass(slots=True)
class Segment:
    """A stretch of a stream without a gap: on the timeline, and in samples of the stream."""

    start_s: float
    end_s: float
    n_before: int
    n_end: int


@dataclass(slots=True)
class PlayingStream:
    """A stream that was asked to be said, and where it lies on the timeline so far."""

    stream: PlayoutStream
    segments: list[Segment] = field(default_factory=list)
    n_taken: int = 0
    is_told: bool = False
    is_starved: bool = False

    def add(self, start_s: float, n_samples: int) -> None:
        """One more block, at a place on the timeline."""
        last = self.segments[-1] if self.segments else None
        if last is not None and abs(last.end_s - start_s) < 1e-6:
            last.end_s, last.n_end = start_s + BLOCK_S, n_samples
        else:
            self.segments.append(Segment(start_s, start_s + BLOCK_S, self.n_taken, n_samples))
        self.n_taken = n_samples

    def n_played(self, position_s: float) -> int:
        """Samples that were heard when the timeline has got there."""
        n = 0
        for segment in self.segments:
            if segment.start_s > position_s:
                break
            n_more = round((position_s - segment.start_s) * self.stream.sample_rate_hz)
            n = min(segment.n_before + n_more, segment.n_end)
        return n

    def timeline_s(self, n_samples: int) -> float | None:
        """Where on the timeline this sample of the stream lies; None: it has not been taken yet."""
        for segment in self.segments:
            if segment.n_before <= n_samples <= segment.n_end:
                n_more = n_samples - segment.n_before
                return segment.start_s + n_more / self.stream.sample_rate_hz
        return None

    def is_heard(self, position_s: float) -> bool:
        """Whether it is over and all of it was heard."""
        return self.stream.is_over and (
            not self.segments or position_s >= self.segments[-1].end_s - 1e-6
        )

    def known_from(self, start_s: float) -> KnownStretch:
        """The phonemes of what is said from `start_s` on, as if without another gap."""
        shift_s = start_s - self.n_taken / self.stream.sample_rate_hz
        moved = [
            replace(
                event,
                start_s=event.start_s + shift_s,
                end_s=None if event.end_s is None else event.end_s + shift_s,
            )
            for event in self.stream.phonemes
        ]
        ahead = tuple(e for e in moved if e.end_s is None or e.end_s > start_s)
        end_s = ahead[-1].end_s if ahead else start_s
        return start_s, float("inf") if end_s is None else end_s, ahead


def add_playing(
    playing: deque[PlayingStream], stream: PlayoutStream, after: PlayoutStream | None
) -> None:
    """Put a stream behind those that wait, or behind the part before it, which cuts nothing in two.

    It is dropped where that part was.
    """
    if after is not None and after.is_dropped:
        stream.drop()
        return
    place = len(playing)
    if after is not None:
        # Where that was heard to its end already: behind what is being said now.
        place = 1 if playing and playing[0].segments else 0
        for number, each in enumerate(playing, 1):
            place = number if each.stream is after else place
    playing.insert(place, PlayingStream(stream))


class KnownPhonemes:
    """Stretches of the timeline whose phonemes are known, each as long as its stream sounds."""

    def __init__(self) -> None:
        self._stretches: deque[KnownStretch] = deque()
        self._going_on: PlayingStream | None = None

    def is_silent(self, start_s: float, end_s: float) -> None:
        """Between them nothing is said, and nobody is listened to."""
        self.sounds(None, start_s)
        last = self._stretches[-1] if self._stretches else None
        if last is not None and last[2] == _SILENCE and abs(last[1] - start_s) < 1e-6:
            self._stretches[-1] = (last[0], end_s, _SILENCE)
        else:
            self._stretches.append((start_s, end_s, _SILENCE))

    def sounds(self, playing: PlayingStream | None, start_s: float) -> None:
        """From `start_s` on this stream is said; None: nothing is."""
        if playing is self._going_on:
            return
        if self._going_on is not None:
            self.cut(start_s)
        if playing is not None and playing.stream.phonemes:
            self._stretches.append(playing.known_from(start_s))
            self._going_on = playing

    def cut(self, cut_s: float) -> None:
        """What was to be said from `cut_s` on never is."""
        self._stretches = deque(
            (start_s, min(end_s, cut_s), events)
            for start_s, end_s, events in self._stretches
            if start_s < cut_s
        )
        self._going_on = None

    def after(self, from_s: float) -> list[KnownStretch]:
        """Those that end after `from_s`, in order, not overlapping."""
        return [stretch for stretch in self._stretches if stretch[1] > from_s]

    def forget(self, committed_s: float) -> None:
        """Those that nobody asks for any more, the timeline being settled until `committed_s`."""
        while self._stretches and self._stretches[0][1] < committed_s - _REMEMBERED_S:
            self._stretches.popleft()
