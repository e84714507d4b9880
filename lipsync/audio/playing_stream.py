"""Where one stream of speech lies on the timeline of what the robot says."""

from dataclasses import dataclass, field

from lipsync.audio.playout_stream import PlayoutStream
from lipsync.audio_block import BLOCK_S


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
