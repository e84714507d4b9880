"""Streams of speech that the robot is to say, and their positions and phonemes on the timeline.

Samples come at any rate and pace: the sender pushes them, the live loop removes blocks of 10 ms.
What costs time, resampling and cutting, is done in the sender's thread. The two threads exchange
blocks through a deque: no lock, no waiting.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, Literal

import numpy as np
import soxr
from numpy.typing import NDArray

from lipsync.audio.source import BLOCK_SAMPLES
from lipsync.audio_block import BLOCK_S, SAMPLE_RATE_HZ
from lipsync.phonemes import SILENCE, PhonemeEvent
from lipsync.spoken_text import MOST_UNITS, PronouncedWord, SpokenText, UnitKind

Samples = NDArray[np.float32]

#: Speech that may wait to be played: five minutes, 72 MB at 48 kHz.
MOST_WAITING_S: Final = 300.0
#: soxr's "LQ" holds back 20 ms, "HQ" 40 (24 and 48 kHz); every one of them is a later first sound.
_RESAMPLING: Final = "LQ"
#: As sound files may have.
LOWEST_RATE_HZ, HIGHEST_RATE_HZ = 4_000, 192_000


class PlayoutFullError(ValueError):
    """Error for pushing more than five minutes of waiting speech; no pushed sample was accepted."""


#: Words of one stream that may wait for the recogniser; a sender with more sends them later.
_MOST_WORDS: Final = 2_000


class PlayoutTextError(ValueError):
    """Error for too many words of a stream, or a time too far ahead; the message is one line."""


@dataclass(frozen=True, slots=True)
class StartedWords:
    """Words that come next in speech, with times in seconds: of their stream, or of the timeline.

    A stream gives out times of the stream, the playout times of the timeline. is_new: the words
    replace all earlier ones not spoken yet. behind_s: seconds of the sound of these words that have
    passed already.
    """

    kind: UnitKind
    words: tuple[PronouncedWord, ...]
    is_new: bool
    behind_s: float = 0.0


@dataclass(frozen=True, slots=True)
class PlayoutBlock:
    """10 ms of a stream: heard by the recogniser, (160,) at 16 kHz; played by the loudspeaker.

    played: at the loudspeaker's rate. n_samples: samples of the stream, at its own rate, up to and
    including this block.
    """

    heard: Samples
    played: Samples
    n_samples: int


class PlayoutStream:
    """A stream of speech: samples are pushed by one thread, blocks are removed by another.

    name: the stream's id. phonemes: its phonemes, where they are known beforehand, in seconds from
    its first sample; empty: the recogniser finds them. played_elsewhere: the sender plays the sound
    itself, and our loudspeaker is silent.
    """

    def __init__(
        self,
        name: str,
        sample_rate_hz: int,
        output_rate_hz: int,
        phonemes: Sequence[PhonemeEvent] = (),
        *,
        played_elsewhere: bool = False,
    ) -> None:
        """Create an empty stream. Raises ValueError for a sample rate that is not possible.

        sample_rate_hz: of the samples pushed; output_rate_hz: the loudspeaker's rate, a multiple of
        100.
        """
        if not LOWEST_RATE_HZ <= sample_rate_hz <= HIGHEST_RATE_HZ:
            allowed = f"{LOWEST_RATE_HZ} to {HIGHEST_RATE_HZ} Hz are possible"
            raise ValueError(f"sample rate {sample_rate_hz} Hz: {allowed}")
        if output_rate_hz % 100:
            raise ValueError(f"output rate {output_rate_hz} Hz must be a multiple of 100 Hz")
        self.name = name
        self.sample_rate_hz = sample_rate_hz
        self.phonemes = tuple(phonemes)
        #: What its sender gave so far: all units of each kind; and words not taken by the playout.
        self.spoken: dict[UnitKind, SpokenText] = {}
        self.started_words: deque[StartedWords] = deque()
        self._words: tuple[PronouncedWord, ...] = ()
        self.played_elsewhere = played_elsewhere
        self._at_16k = _Resampler(sample_rate_hz, SAMPLE_RATE_HZ)
        self._output = _Resampler(sample_rate_hz, output_rate_hz)
        self._blocks: deque[PlayoutBlock] = deque()
        self._marks: deque[tuple[int, str]] = deque()
        self._n_received = 0
        # Blocks that were cut since the last `fill`, and the stream's samples before these blocks.
        self._n_cut = 0
        self._n_before = 0
        self._is_marked = False
        self._is_filled = False
        self._ended = False
        self._dropped = False

    @property
    def n_received(self) -> int:
        """The number of samples that were pushed so far, at the stream's own rate."""
        return self._n_received

    @property
    def waiting_s(self) -> float:
        """Seconds of speech that were pushed and not removed yet, in whole blocks."""
        return len(self._blocks) * BLOCK_S

    @property
    def ended(self) -> bool:
        """Whether the stream has ended or was dropped, so that no more is accepted."""
        return self._ended

    @property
    def is_marked(self) -> bool:
        """Whether a mark was set after the last `push`: the sender may wait until it is heard."""
        return self._is_marked

    @property
    def is_filled(self) -> bool:
        """Whether all pushed samples can be taken: `fill` was called after the last `push`."""
        return self._is_filled

    @property
    def is_dropped(self) -> bool:
        """Whether the stream was dropped: its blocks that were not taken are never played."""
        return self._dropped

    @property
    def is_over(self) -> bool:
        """Whether the stream has ended and every block was taken or dropped."""
        return self._ended and (self._dropped or not self._blocks)

    def push(self, samples: Samples) -> None:
        """Add samples (n,) float32 in [-1, 1] to the stream; ignored if it was dropped.

        Raises PlayoutFullError when more than five minutes would wait, and ValueError once the
        stream has ended.
        """
        if self._dropped:
            return
        if self._ended:
            raise ValueError(f"stream {self.name!r} has ended; start a new one")
        if self.waiting_s + len(samples) / self.sample_rate_hz > MOST_WAITING_S:
            waiting = f"{MOST_WAITING_S:g} s of speech wait already"
            raise PlayoutFullError(f"stream {self.name!r}: {waiting}")
        self._n_received += len(samples)
        self._is_marked = self._is_filled = False
        self._at_16k.push(samples)
        self._output.push(samples)
        self._cut_blocks()

    def tell(self, spoken: SpokenText, words: Sequence[PronouncedWord] = ()) -> None:
        """Add units (words, phonemes, ...) of the speech to the earlier units of the same kind.

        If the first unit has a start, the units replace the earlier ones from there on. Phonemes
        and visemes with times move the mouth; all else is aligned with the sound. words: those of
        `spoken`, with possible pronunciations, in seconds of the stream. Raises PlayoutTextError
        and SpokenTextError; then nothing was added. Ignored if the stream is over.
        """
        if self._ended and (self._dropped or not self._blocks):
            return
        # Start of the last unit given; 0 where it has none.
        newest = max(
            (t for unit in spoken.units[-1:] for t in (unit.start_sample or 0,)), default=0
        )
        if newest > self._n_received + MOST_WAITING_S * self.sample_rate_hz:
            raise PlayoutTextError(
                f"sample {newest} is more than {MOST_WAITING_S:g} s after the sound sent so far"
            )
        waiting = list(self.started_words)  # at once: the live loop takes them meanwhile
        if sum(len(group.words) for group in waiting) + len(words) > _MOST_WORDS:
            raise PlayoutTextError(f"{_MOST_WORDS} words wait to be spoken; send more later")
        earlier = self.spoken.get(spoken.kind)
        all_units = spoken if earlier is None else earlier.revised(spoken)
        if words:
            # Words replace a text: they have times, or are nearer to the sound than a text is.
            is_better = spoken.kind != "text" and "text" in self.spoken and earlier is None
            is_worse = spoken.kind == "text" and "word" in self.spoken
            if not is_worse:
                self._queue_words(spoken, words, is_better=is_better)
        if spoken.is_timed or not spoken.moves_mouth:
            self.spoken = {**self.spoken, spoken.kind: all_units}

    def _queue_words(
        self, spoken: SpokenText, words: Sequence[PronouncedWord], *, is_better: bool
    ) -> None:
        """Queue the words of `spoken` in `started_words`, after earlier words or in their place.

        All earlier words are replaced if `is_better`, as by words in place of a text; if `spoken`
        corrects earlier units, those from its start on.
        """
        earlier = self.spoken.get(spoken.kind)
        is_correction = earlier is not None and earlier.is_corrected_by(spoken)
        from_s = (spoken.units[0].start_sample or 0) / self.sample_rate_hz
        if is_better or is_correction:
            self._words = tuple(
                word
                for word in self._words
                if is_correction and from_s and (word.start_s is None or word.start_s < from_s)
            )
            self._words += tuple(words)
            self.started_words.append(StartedWords(spoken.kind, self._words, is_new=True))
        else:
            self._words = (*self._words, *words)[-MOST_UNITS:]
            self.started_words.append(StartedWords(spoken.kind, tuple(words), is_new=False))

    def mark(self, name: str) -> None:
        """Set a mark `name`, to be reported when all samples pushed until now have been heard."""
        self._marks.append((self._n_received, name))
        self._is_marked = True

    def end(self) -> None:
        """End the stream: no more samples come; the last block is filled up with silence."""
        if not self._ended:
            self.fill()
            self._ended = True

    def fill(self) -> None:
        """Flush the resamplers and fill the last block up with silence, as the sender pauses."""
        if self._is_filled:
            return
        both = (self._at_16k, BLOCK_SAMPLES), (self._output, self._output.rate_hz // 100)
        for resampler, _ in both:
            resampler.push(np.zeros(0, dtype=np.float32), last=True)
        # The two rates may differ by a sample, which may begin a block: the longer one decides.
        n_blocks = max(-(-resampler.n_ready // n_block) for resampler, n_block in both)
        for resampler, n_block in both:
            resampler.fill(n_blocks * n_block)
        self._cut_blocks()
        self._n_before, self._n_cut = self._n_received, 0
        self._is_filled = True

    def take(self) -> PlayoutBlock | None:
        """Remove and return the next block; None: none has come yet, or the stream was dropped."""
        return self._blocks.popleft() if self._blocks and not self._dropped else None

    def put_back(self, block: PlayoutBlock) -> None:
        """Put the block that was taken last back at the front, to be taken again."""
        if not self._dropped:
            self._blocks.appendleft(block)

    def drop(self) -> None:
        """Drop all blocks not removed yet and end the stream; the removing thread calls it."""
        self._dropped = self._ended = True
        self._blocks.clear()

    def marks_until(self, n_samples: int) -> list[str]:
        """Remove and return the names of the marks up to sample `n_samples` of the stream."""
        reached = []
        while self._marks and self._marks[0][0] <= n_samples:
            reached.append(self._marks.popleft()[1])
        return reached

    def _cut_blocks(self) -> None:
        """Cut as many blocks of 10 ms as both resamplers have samples for."""
        n_output = self._output.rate_hz // 100
        while self._at_16k.n_ready >= BLOCK_SAMPLES and self._output.n_ready >= n_output:
            self._n_cut += 1
            n_samples = self._n_before + round(self._n_cut * BLOCK_S * self.sample_rate_hz)
            heard, played = self._at_16k.take(BLOCK_SAMPLES), self._output.take(n_output)
            self._blocks.append(PlayoutBlock(heard, played, min(self._n_received, n_samples)))


class _Resampler:
    """A resampler: samples are pushed at one rate and removed at another."""

    def __init__(self, from_hz: int, to_hz: int) -> None:
        """Create a resampler between two rates in Hz; equal rates pass samples unchanged."""
        self.rate_hz = to_hz
        self._resampler = (
            None
            if from_hz == to_hz
            else soxr.ResampleStream(from_hz, to_hz, 1, dtype="float32", quality=_RESAMPLING)
        )
        self._ready: Samples = np.zeros(0, dtype=np.float32)

    @property
    def n_ready(self) -> int:
        """The number of samples at the new rate that can be taken."""
        return len(self._ready)

    def push(self, samples: Samples, *, last: bool = False) -> None:
        """Resample and append samples (n,); `last`: also those that the resampler holds back."""
        if self._resampler is not None:
            samples = self._resampler.resample_chunk(samples, last=last)
            if last:
                self._resampler.clear()
        self._ready = np.concatenate((self._ready, samples))

    def fill(self, n_samples: int) -> None:
        """Append silence until `n_samples` are ready."""
        silence = np.zeros(n_samples - len(self._ready), dtype=np.float32)
        self._ready = np.concatenate((self._ready, silence))

    def take(self, n_samples: int) -> Samples:
        """Remove and return the first `n_samples` that are ready."""
        taken, self._ready = self._ready[:n_samples], self._ready[n_samples:]
        return taken


EventKind = Literal[
    "started", "mark", "finished", "interrupted", "cleared", "underrun", "paused", "resumed",
    "moved_by", "units_shifted", "text_dropped",
]  # fmt: skip


#: Why the mouth is moved by what moves it: the sender gave it (told), gave nothing better for this
#: sound (not_told), gave what is not in the sound (not_said), or gave words that a recogniser that
#: fell back does not follow (not_followed).
MoverReason = Literal["told", "not_told", "not_said", "not_followed"]


@dataclass(frozen=True, slots=True)
class PlayoutEvent:
    """An event of a stream (started, mark, finished, ...), reported when it is heard.

    position_s: the timeline position. n_played: samples of the stream, at its own rate, that were
    heard so far; n_dropped: samples that will never be heard. name: that of a mark; what moves the
    mouth from now on (moved_by), for which `reason`. shifted_s: how much later than sent units
    sound (units_shifted).
    """

    kind: EventKind
    stream: str
    position_s: float
    n_played: int = 0
    n_dropped: int = 0
    name: str = ""
    reason: MoverReason = "told"
    shifted_s: float = 0.0


@dataclass(frozen=True, slots=True)
class PlayoutRequest:
    """A request to the playout: to play a stream, or to change what is played.

    say: queue a new stream behind those that wait, or right after `after`, of which it is the next
    part: it is dropped if `after` was. interrupt: silence at once, and everything that was not
    heard is dropped. clear: what is not yet on its way to the loudspeaker is dropped, of the
    streams called `name` alone, or of all. pause: silence at once, and what was not heard is kept
    until resume.
    """

    kind: Literal["say", "interrupt", "clear", "pause", "resume"]
    stream: PlayoutStream | None = None
    after: PlayoutStream | None = None
    name: str = ""


#: Known phonemes are remembered so long after their end: a recogniser does not reach farther back.
_REMEMBERED_S: Final = 5.0

#: Endless silence: it counts within its stretch only.
_SILENCE: Final = (PhonemeEvent(SILENCE, 0.0, None),)

#: (start_s, end_s, events) on the timeline; an event may reach beyond the end, where it is cut off.
KnownStretch = tuple[float, float, tuple[PhonemeEvent, ...]]


@dataclass(slots=True)
class Segment:
    """A stretch of a stream played without a gap: in timeline seconds, and in its samples.

    n_before, n_end: the stream's samples before the stretch, and up to its end.
    """

    start_s: float
    end_s: float
    n_before: int
    n_end: int


@dataclass(slots=True)
class PlayingStream:
    """A stream that was queued to play, and the segments of the timeline at which it was played.

    n_taken: its samples on the timeline so far. has_begun: its start was reported. is_starved: it
    ran out of sound and waits for more. is_followed: some of its words went to `take_words`.
    """

    stream: PlayoutStream
    segments: list[Segment] = field(default_factory=list)
    n_taken: int = 0
    has_begun: bool = False
    is_starved: bool = False
    is_followed: bool = False

    def add_block(self, start_s: float, n_samples: int) -> None:
        """Record that the block of 10 ms at timeline position `start_s` plays the stream's samples.

        n_samples: samples of the stream up to and including this block.
        """
        last = self.segments[-1] if self.segments else None
        if last is not None and abs(last.end_s - start_s) < 1e-6 and not self._is_filled_up(last):
            last.end_s, last.n_end = start_s + BLOCK_S, n_samples
        else:
            self.segments.append(Segment(start_s, start_s + BLOCK_S, self.n_taken, n_samples))
        self.n_taken = n_samples

    def remove_block(self, start_s: float, n_before: int) -> None:
        """Remove the last block, added at `start_s`; `n_before`: the stream's samples before."""
        last = self.segments[-1]
        last.end_s, last.n_end = start_s, n_before
        if last.end_s - last.start_s < 1e-6:
            self.segments.pop()
        self.n_taken = n_before

    def _is_filled_up(self, segment: Segment) -> bool:
        """Return whether a segment ends with filled-in silence, where the sender paused."""
        n_duration = (segment.end_s - segment.start_s) * self.stream.sample_rate_hz
        return segment.n_end - segment.n_before < n_duration - 1.5

    def n_played(self, position_s: float) -> int:
        """Return how many samples of the stream are heard by a timeline position in s."""
        n = 0
        for segment in self.segments:
            if segment.start_s > position_s:
                break
            n_more = round((position_s - segment.start_s) * self.stream.sample_rate_hz)
            n = min(segment.n_before + n_more, segment.n_end)
        return n

    def timeline_s(self, n_samples: int) -> float | None:
        """Return the timeline position in s of sample `n_samples`; None: it is not played yet."""
        for segment in self.segments:
            if segment.n_before <= n_samples <= segment.n_end:
                n_more = n_samples - segment.n_before
                return segment.start_s + n_more / self.stream.sample_rate_hz
        return None

    def is_heard(self, position_s: float) -> bool:
        """Return whether the stream is over and all of it is heard by timeline `position_s`."""
        return self.stream.is_over and (
            not self.segments or position_s >= self.segments[-1].end_s - 1e-6
        )

    @property
    def shift_s(self) -> float:
        """The timeline position in s of the stream's first sample, by its newest segment."""
        last = self.segments[-1]
        return last.start_s - last.n_before / self.stream.sample_rate_hz

    def known_from(self, start_s: float) -> KnownStretch:
        """Return (start_s, end_s, events): the stream's own phonemes not over at `start_s`.

        In timeline seconds, as if the stream plays without a gap from there on; end_s is inf where
        the last phoneme has no end.
        """
        shift_s = start_s - self.n_taken / self.stream.sample_rate_hz
        events = [event.later(shift_s) for event in self.stream.phonemes]
        ahead = tuple(each for each in events if each.end_s is None or each.end_s > start_s)
        last = ahead[-1].end_s if ahead else start_s
        return start_s, float("inf") if last is None else last, ahead


@dataclass(frozen=True, slots=True)
class TimedUnits:
    """The units with times that a stream's sender gave for the sound from `from_s` on; None: none.

    All times are timeline seconds. start_s: where the stream's sound began, or went on after a gap;
    shift_s: where its sample 0 would be if it had played without gaps.
    """

    stream: str
    from_s: float
    units: SpokenText | None = None
    start_s: float = 0.0
    shift_s: float = 0.0


def phonemes_or_visemes(stream: PlayoutStream) -> SpokenText | None:
    """Return the phonemes with times that the sender gave, else visemes with times, else None."""
    for kind in ("phoneme", "viseme"):
        units = stream.spoken.get(kind)
        if units is not None and units.units and units.units[-1].start_sample is not None:
            return units
    return None


def add_playing(
    playing: deque[PlayingStream], stream: PlayoutStream, after: PlayoutStream | None
) -> None:
    """Insert a stream at the end of the queue, or behind `after`, the stream that it continues.

    If `after` was dropped, drop the stream instead; if `after` was heard to its end, queue it
    behind the stream that is being played.
    """
    if after is not None and after.is_dropped:
        stream.drop()
        return
    index = len(playing)
    if after is not None:
        # If `after` is not queued any more, behind the stream that plays now.
        index = 1 if playing and playing[0].segments else 0
        for number, queued in enumerate(playing, 1):
            index = number if queued.stream is after else index
    playing.insert(index, PlayingStream(stream))


class KnownPhonemes:
    """The stretches of the timeline whose phonemes are known, each as long as its stream sounds."""

    def __init__(self) -> None:
        self._stretches: deque[KnownStretch] = deque()
        self._sounding: PlayingStream | None = None

    def add_silence(self, start_s: float, end_s: float) -> None:
        """Add a known stretch of silence from `start_s` to `end_s`: no stream plays there."""
        self.note_playing(None, start_s)
        last = self._stretches[-1] if self._stretches else None
        if last is not None and last[2] == _SILENCE and abs(last[1] - start_s) < 1e-6:
            self._stretches[-1] = (last[0], end_s, _SILENCE)
        else:
            self._stretches.append((start_s, end_s, _SILENCE))

    def note_playing(self, playing: PlayingStream | None, start_s: float) -> None:
        """Add the known phonemes of the stream that plays from `start_s` on; called for each block.

        playing: None where no stream plays; then the phonemes of the last stream end there.
        """
        if playing is self._sounding:
            return
        if self._sounding is not None:
            self.cut(start_s)
        if playing is not None and playing.stream.phonemes:
            self._stretches.append(playing.known_from(start_s))
            self._sounding = playing

    def cut(self, cut_s: float) -> None:
        """Remove everything after timeline position `cut_s`, because it will not be played."""
        self._stretches = deque(
            (start_s, min(end_s, cut_s), events)
            for start_s, end_s, events in self._stretches
            if start_s < cut_s
        )
        self._sounding = None

    def after(self, from_s: float) -> list[KnownStretch]:
        """Return the stretches (start_s, end_s, events) that end after `from_s`, in order."""
        return [stretch for stretch in self._stretches if stretch[1] > from_s]

    def forget(self, committed_s: float) -> None:
        """Drop stretches that ended over 5 s before `committed_s`, too old for any query."""
        while self._stretches and self._stretches[0][1] < committed_s - _REMEMBERED_S:
            self._stretches.popleft()
