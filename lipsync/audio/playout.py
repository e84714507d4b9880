"""What the robot says, on one timeline: streams of speech one after the other, silence between.

The live loop asks for blocks as sound time passes. A block is *committed* then: the recogniser
hears it at once, the loudspeaker plays it a declared delay later. So the loudspeaker always holds
that delay in sound, and lips and sound meet. Where a stream has nothing ready, silence is
committed, and the stream goes on when more has come.

Other threads only append to `requests` and take from `events`; all is decided in the loop.
"""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Final, Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from lipsync.audio.cutter import BLOCK_SAMPLES
from lipsync.audio.playout_stream import PlayoutStream
from lipsync.audio_block import SAMPLE_RATE_HZ, AudioBlock, samples_before
from lipsync.phonemes import PhonemeEvent

Samples = NDArray[np.float32]

#: Requests that wait for the next tick; streams beyond it are refused by whoever receives them.
_MOST_REQUESTS: Final = 64
#: Events that wait to be told; the oldest are dropped beyond it.
_MOST_EVENTS: Final = 1024
#: Phonemes that were known beforehand are remembered so long after they were said: a recogniser
#: does not reach farther back.
_REMEMBERED_S: Final = 5.0
_BLOCK_S: Final = BLOCK_SAMPLES / SAMPLE_RATE_HZ
_SILENCE: Final = np.zeros(BLOCK_SAMPLES, dtype=np.float32)
_SILENCE.flags.writeable = False


class Loudspeaker(Protocol):
    """Where committed sound is played. Time is the timeline's: of what was written, first to last.

    Called by the live loop: nothing here may wait.
    """

    @property
    def rate_hz(self) -> int:
        """Samples a second, a multiple of 100."""

    def write(self, samples: Samples) -> None:
        """The next samples (n,) float32 mono of the timeline."""

    def silence_rest(self) -> float:
        """Play silence in place of all that is written and still within reach.

        Gives the timeline position, in seconds, from which on it is silent.
        """

    def position(self) -> tuple[float, float] | None:
        """(monotonic seconds, timeline seconds that leave the loudspeaker then).

        The newest report of the device; None before the first.
        """


EventKind = Literal["started", "mark", "finished", "interrupted", "cleared", "underrun"]


@dataclass(frozen=True, slots=True)
class PlayoutEvent:
    """What became of a stream, told when it leaves the loudspeaker.

    position_s: on the timeline. n_played: samples of the stream, at its own rate, that were heard
    so far; n_dropped: that never will be. name: of a mark.
    """

    kind: EventKind
    stream: str
    position_s: float
    n_played: int = 0
    n_dropped: int = 0
    name: str = ""


@dataclass(frozen=True, slots=True)
class PlayoutRequest:
    """What is asked of the playout.

    say: a new stream, after those that wait. interrupt: silence at once, and everything that was
    not heard is dropped. clear: what is not yet on its way to the loudspeaker is dropped.
    """

    kind: Literal["say", "interrupt", "clear"]
    stream: PlayoutStream | None = None


@dataclass(slots=True)
class _Segment:
    """A stretch of a stream without a gap: on the timeline, and in samples of the stream."""

    start_s: float
    end_s: float
    n_before: int
    n_end: int


@dataclass(slots=True)
class _Playing:
    """A stream that was asked to be said, and where it lies on the timeline so far."""

    stream: PlayoutStream
    segments: list[_Segment] = field(default_factory=list)
    n_taken: int = 0
    is_told: bool = False
    is_starved: bool = False

    def add(self, start_s: float, n_samples: int) -> None:
        """One more block, at a place on the timeline."""
        last = self.segments[-1] if self.segments else None
        if last is not None and abs(last.end_s - start_s) < 1e-6:
            last.end_s, last.n_end = start_s + _BLOCK_S, n_samples
        else:
            self.segments.append(_Segment(start_s, start_s + _BLOCK_S, self.n_taken, n_samples))
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

    def is_heard(self, position_s: float) -> bool:
        """Whether it is over and all of it was heard."""
        return self.stream.is_over and (
            not self.segments or position_s >= self.segments[-1].end_s - 1e-6
        )


class Playout:
    """An `AudioSource` without end, of what the robot says; see the module."""

    name = "own voice"
    duration_s: float | None = None
    is_live = False
    #: What has not come in time is said later; nothing is lost.
    lost_blocks = 0

    def __init__(self, loudspeaker: Loudspeaker | None = None) -> None:
        """loudspeaker: None where nobody plays, or whoever sends the stream does."""
        self._loudspeaker = loudspeaker
        n_played = BLOCK_SAMPLES if loudspeaker is None else loudspeaker.rate_hz // 100
        self._played_silence: Samples = np.zeros(n_played, dtype=np.float32)
        #: Any thread appends.
        self.requests: deque[PlayoutRequest] = deque(maxlen=_MOST_REQUESTS)
        #: One other thread takes.
        self.events: deque[PlayoutEvent] = deque(maxlen=_MOST_EVENTS)
        self._playing: deque[_Playing] = deque()
        self._known: deque[tuple[float, float, tuple[PhonemeEvent, ...]]] = deque()
        self._n_blocks = 0
        self._n_underruns = 0
        self._position_s = 0.0

    @property
    def output_rate_hz(self) -> int:
        """The rate that new streams are made for."""
        return 100 * len(self._played_silence)

    @property
    def n_underruns(self) -> int:
        """How often a stream had nothing ready in the middle of its speech."""
        return self._n_underruns

    @property
    def committed_s(self) -> float:
        """The timeline is settled until then."""
        return self._n_blocks * _BLOCK_S

    @property
    def position_s(self) -> float:
        """What leaves the loudspeaker, on the timeline, as `advance` was told last."""
        return self._position_s

    @property
    def is_speaking(self) -> bool:
        """Whether something is being said or heard, or waits."""
        return bool(self._playing)

    def n_played(self, stream: str) -> int | None:
        """Samples of a stream, at its own rate, that were heard so far; None: it does not play."""
        for playing in self._playing:
            if playing.stream.name == stream:
                return playing.n_played(self._position_s)
        return None

    def advance(self, position_s: float) -> bool:
        """Do what was requested, and tell what was heard; whether sound was cut off just now.

        position_s: on the timeline, what leaves the loudspeaker now.
        """
        self._position_s = max(self._position_s, position_s)
        is_cut = False
        while self.requests:
            request = self.requests.popleft()
            if request.kind == "say" and request.stream is not None:
                self._playing.append(_Playing(request.stream))
            elif request.kind == "interrupt":
                is_cut = self._interrupt() or is_cut
            elif request.kind == "clear":
                self._clear()
        self._tell()
        while self._known and self._known[0][1] < self.committed_s - _REMEMBERED_S:
            self._known.popleft()
        return is_cut

    def blocks(self, until_s: float) -> list[AudioBlock]:
        """Commit the timeline until then; the new blocks as the recogniser is to hear them."""
        return list(self._commit(int(samples_before(max(0.0, until_s))) // BLOCK_SAMPLES))

    def known_phonemes(self, from_s: float) -> list[tuple[float, float, tuple[PhonemeEvent, ...]]]:
        """Stretches of the timeline that end after `from_s` and whose phonemes are known.

        (start_s, end_s, events), all on the timeline.
        """
        return [stretch for stretch in self._known if stretch[1] > from_s]

    def __enter__(self) -> "Playout":
        return self

    def __exit__(self, *exc: object) -> None:
        """Nothing to give back; the loudspeaker is whoever's opened it."""

    def _commit(self, n_until: int) -> Iterator[AudioBlock]:
        while self._n_blocks < n_until:
            start_s = self.committed_s
            self._n_blocks += 1
            heard, played = self._next(start_s)
            if self._loudspeaker is not None:
                self._loudspeaker.write(played)
            yield AudioBlock(heard, start_s)

    def _next(self, start_s: float) -> tuple[Samples, Samples]:
        playing = next((each for each in self._playing if not each.stream.is_over), None)
        block = None if playing is None else playing.stream.take()
        if playing is None or block is None:
            if playing is not None and playing.segments and not playing.is_starved:
                self._note_underrun(playing)
            return _SILENCE, self._played_silence
        stream = playing.stream
        if stream.phonemes and not playing.segments:
            self._remember(stream, start_s)
        playing.is_starved = False
        playing.add(start_s, block.n_samples)
        # A recogniser that hears what is known anyway would only disagree.
        return (_SILENCE if stream.phonemes else block.heard), block.played

    def _note_underrun(self, playing: _Playing) -> None:
        playing.is_starved = True
        self._n_underruns += 1
        n_played = playing.n_played(self._position_s)
        name = playing.stream.name
        self.events.append(PlayoutEvent("underrun", name, self._position_s, n_played))

    def _remember(self, stream: PlayoutStream, start_s: float) -> None:
        moved = tuple(
            replace(
                event,
                start_s=event.start_s + start_s,
                end_s=None if event.end_s is None else event.end_s + start_s,
            )
            for event in stream.phonemes
        )
        end_s = start_s + stream.n_received / stream.sample_rate_hz
        self._known.append((start_s, end_s, moved))

    def _interrupt(self) -> bool:
        """Everything ends here; whether anything was being said."""
        if not self._playing:
            return False
        cut_s = self._position_s
        if self._loudspeaker is not None:
            cut_s = self._loudspeaker.silence_rest()
        for playing in self._playing:
            playing.stream.drop()
            n_played = playing.n_played(cut_s)
            n_dropped = playing.stream.n_received - n_played
            event = PlayoutEvent("interrupted", playing.stream.name, cut_s, n_played, n_dropped)
            self.events.append(event)
        self._playing.clear()
        self._known = deque((start, min(end, cut_s), said) for start, end, said in self._known)
        return True

    def _clear(self) -> None:
        """What is committed is still heard; the rest is not."""
        for playing in self._playing:
            if playing.stream.is_over:
                continue
            playing.stream.drop()
            n_played = playing.n_played(self._position_s)
            n_dropped = playing.stream.n_received - playing.n_taken
            name = playing.stream.name
            self.events.append(PlayoutEvent("cleared", name, self._position_s, n_played, n_dropped))

    def _tell(self) -> None:
        """Starts, marks and ends that the position has passed."""
        while self._playing:
            playing, position_s = self._playing[0], self._position_s
            name = playing.stream.name
            if not playing.is_told:
                begins_s = playing.segments[0].start_s if playing.segments else None
                if begins_s is None and not playing.stream.is_over:
                    return
                if begins_s is not None and position_s < begins_s:
                    return
                playing.is_told = True
                self.events.append(PlayoutEvent("started", name, position_s))
            n_played = playing.n_played(position_s)
            for mark in playing.stream.marks_until(n_played):
                self.events.append(PlayoutEvent("mark", name, position_s, n_played, name=mark))
            if not playing.is_heard(position_s):
                return
            self.events.append(PlayoutEvent("finished", name, position_s, n_played))
            self._playing.popleft()
