"""How every recogniser is run over a stream of sound: live, in replay, and when measured.

`RecognizerStream` feeds blocks, collects the updates, measures the cost, and calls observers.
`SoundAhead` returns a source's blocks at their times; for sound that is not live it lets the
recogniser compute ahead on many blocks at once, which is cheaper and changes no result and no time.

Recognisers share `AudioInput`, which turns blocks of any size and rate into gapless 16 kHz sound,
and `UpdateBuilder`, which turns one phoneme a frame into updates and never revises final ones.
"""

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from typing import Protocol, runtime_checkable

import numpy as np
import soxr
from numpy.typing import NDArray

from lipsync.arrays import Array32
from lipsync.audio.source import BLOCK_SAMPLES, AudioSource
from lipsync.audio_block import SAMPLE_RATE_HZ, AudioBlock, samples_before
from lipsync.phonemes import SILENCE, LiveRecognizer, PhonemeEvent, PhonemeUpdate


@runtime_checkable
class PreparingRecognizer(LiveRecognizer, Protocol):
    """A recogniser that can compute ahead on sound that will be fed to it later."""

    @property
    def ahead_s(self) -> float:
        """Seconds of sound that are best given to `prepare` at once.

        0: nothing is prepared, as a caller waits for each tick.
        """

    def prepare(self, blocks: Sequence[AudioBlock]) -> None:
        """Compute ahead on the blocks that will be fed next, one by one.

        What `updates` returns depends on the blocks that were fed, not on those prepared.
        """


@runtime_checkable
class BacklogRecognizer(LiveRecognizer, Protocol):
    """A recogniser that accepts all waiting blocks in one call."""

    def feed_all(self, blocks: Sequence[AudioBlock]) -> None:
        """Process blocks that follow each other in time, the oldest first."""


@dataclass(frozen=True, slots=True)
class StreamStep:
    """The input and the result of one step of a stream.

    blocks: those fed; updates: the recogniser's updates after them; cost_s: processor time in s of
    the step's thread, 0 without an observer (reading that clock is a system call).
    """

    blocks: Sequence[AudioBlock]
    updates: Sequence[PhonemeUpdate]
    cost_s: float


class StreamObserver(Protocol):
    """An object that is called with every step of a stream, in order."""

    def observe(self, step: StreamStep) -> None:
        """Process one step; `RecognizerStream` calls it after the recogniser was fed."""


class RecognizerStream:
    """A stream of sound through a recogniser, fed in steps, with observers of each step."""

    def __init__(
        self,
        recognizer: LiveRecognizer,
        observers: Sequence[StreamObserver] = (),
        clock_ns: Callable[[], int] = time.thread_time_ns,
    ) -> None:
        """Create the stream with observers of its steps.

        clock_ns: returns the time in ns by which a step's cost is measured; default: this thread's
        CPU time.
        """
        self._recognizer = recognizer
        self._backlog = recognizer if isinstance(recognizer, BacklogRecognizer) else None
        self._observers = tuple(observers)
        self._clock_ns = clock_ns

    def feed(self, blocks: Sequence[AudioBlock]) -> StreamStep:
        """Feed the blocks in one step, get the updates, call the observers; return the step."""
        began_ns = self._clock_ns() if self._observers else 0
        if self._backlog is not None:
            self._backlog.feed_all(blocks)
        else:
            for block in blocks:
                self._recognizer.feed(block)
        updates = self._recognizer.updates()
        cost_ns = self._clock_ns() - began_ns if self._observers else 0
        step = StreamStep(blocks, updates, cost_ns * 1e-9)
        for observer in self._observers:
            observer.observe(step)
        return step

    def run(self, blocks: Iterable[AudioBlock]) -> None:
        """Feed all blocks, each in a step of its own."""
        for block in blocks:
            self.feed((block,))


class SoundAhead:
    """The blocks of a sound source at their times; a `PreparingRecognizer` gets them ahead of time.

    Of a live source no sound is known ahead, and none is prepared.
    """

    def __init__(self, source: AudioSource, recognizer: LiveRecognizer) -> None:
        """Read `source` ahead for `recognizer`, if it can prepare and the source is not live."""
        self._source = source
        self._preparing = (
            recognizer
            if isinstance(recognizer, PreparingRecognizer) and not source.is_live
            else None
        )
        self._prepared_until_s = 0.0
        self._waiting: deque[AudioBlock] = deque()

    def blocks(self, until_s: float) -> list[AudioBlock]:
        """Return the blocks, not returned before, that end at or before sound time `until_s`."""
        if self._preparing is not None and until_s > self._prepared_until_s:
            ahead_s = self._preparing.ahead_s
            if ahead_s > 0.0:
                self._prepared_until_s = until_s + ahead_s
                prepared = self._source.blocks(self._prepared_until_s)
                self._preparing.prepare(prepared)
                self._waiting.extend(prepared)
        # Prepared blocks that are due; more of the source only where none is left waiting.
        n_due = samples_before(until_s)
        due = []
        while self._waiting and round(self._waiting[0].end_s * SAMPLE_RATE_HZ) <= n_due:
            due.append(self._waiting.popleft())
        return due if self._waiting else due + self._source.blocks(until_s)


def blocks_of(
    samples: NDArray[np.float32], n_first: int = BLOCK_SAMPLES, n_block: int = BLOCK_SAMPLES
) -> Iterator[AudioBlock]:
    """Yield samples cut into blocks from sound time 0; the last block may be shorter.

    Parameters
    ----------
    samples : NDArray[np.float32]
        (n,) at 16 kHz.
    n_first,n_block : int
        Samples of the first block, and of each later one.

    Returns
    -------
    Iterator[AudioBlock]
        Blocks of sound at 16 kHz.
    """
    edges = [0, *range(n_first, len(samples), n_block), len(samples)]
    for start, end in pairwise(edges):
        yield AudioBlock(samples[start:end], start / SAMPLE_RATE_HZ)


#: Of a longer gap between blocks only this much is filled with silence, then time jumps to its end.
HEARD_GAP_S = 2.0


class AudioInput:
    """The input of a stream: blocks of sound become 16 kHz samples, with silence in the gaps.

    Sound at another rate is resampled as it comes (soxr), which delays up to 40 ms of it. NaN and
    infinity become silence; samples beyond full scale are clipped.
    """

    def __init__(self) -> None:
        self._rate_hz: int | None = None
        self._n_fed = 0  # samples at the stream's own rate, gaps among them
        self._resampler: soxr.ResampleStream | None = None

    def convert(self, block: AudioBlock) -> tuple[Array32, float, Array32]:
        """Return the silence and the seconds skipped in the gap before a block, and its samples.

        Parameters
        ----------
        block : AudioBlock
            Sound of any rate; the same rate for a whole stream.

        Returns
        -------
        tuple[Array32, float, Array32]
            Silence that comes first, (n,) samples, at most 2 s; seconds of the gap to jump over
            after it, a multiple of 10 ms; the block's own samples, (m,) at 16 kHz.

        Raises
        ------
        ValueError
            The block starts before the last one's end, or has another rate.
        """
        if self._rate_hz is None:
            self._begin(block.sample_rate_hz)
        rate_hz = block.sample_rate_hz
        if rate_hz != self._rate_hz:
            raise ValueError(
                f"sound at {rate_hz} Hz in a stream at {self._rate_hz} Hz; reset for a new stream"
            )
        n_missing = round(block.start_s * rate_hz) - self._n_fed
        if n_missing < 0:
            raise ValueError(
                f"the block starts at {block.start_s} s, but sound was heard until "
                f"{self._n_fed / rate_hz} s; feed blocks in order, or reset for a new stream"
            )
        # Up to 2 s of the gap become silence; whole steps of 10 ms beyond are skipped.
        n_jumps = max(0, n_missing - round(HEARD_GAP_S * rate_hz)) * 100 // rate_hz
        n_silent = n_missing - n_jumps * rate_hz // 100
        self._n_fed += n_missing + len(block.samples)
        silence = self._resample(np.zeros(n_silent, np.float32))
        finite = np.where(np.isfinite(block.samples), block.samples, np.float32(0.0))
        samples = np.clip(finite, -1.0, 1.0)
        return silence, n_jumps / 100, self._resample(samples.astype(np.float32, copy=False))

    def _begin(self, rate_hz: int) -> None:
        """Set the rate of the stream, and create the resampler if it is not 16 kHz."""
        self._rate_hz = rate_hz
        if rate_hz != SAMPLE_RATE_HZ:
            self._resampler = soxr.ResampleStream(rate_hz, SAMPLE_RATE_HZ, 1, dtype="float32")

    def _resample(self, samples: Array32) -> Array32:
        """Return what the resampler has ready at 16 kHz; at 16 kHz the samples themselves."""
        if self._resampler is None or len(samples) == 0:
            return samples
        resampled: Array32 = self._resampler.resample_chunk(samples)
        return np.clip(resampled, -1.0, 1.0)


class UpdateBuilder:
    """Builder of `PhonemeUpdate`s from a recogniser's phonemes, one for each frame.

    Frames count from sound time 0, `frames_per_s` a second. At each update all frames but the last
    `latency_frames` become final. An event is a run of frames with equal phonemes.
    """

    def __init__(self, frames_per_s: int, latency_frames: int) -> None:
        self._frames_per_s = frames_per_s
        self._latency_frames = latency_frames
        self._n_final = 0
        self._last_final = SILENCE
        self._run_start = 0  # the first frame of the run that the last final frame belongs to

    @property
    def n_final(self) -> int:
        """The number of final frames, which is also the number of the first one not final."""
        return self._n_final

    def update(self, phonemes: Sequence[str], n_later: int = 0) -> PhonemeUpdate:
        """Return the update for the phonemes of all frames from the first not final to the newest.

        n_later: number of frames beyond `latency_frames` that may still change. The first event
        keeps its earlier start when the last final frame belongs to it.
        """
        runs = self._runs(phonemes)
        n_final_before, n_heard = self._n_final, self._n_final + len(phonemes)
        self._n_final = max(self._n_final, n_heard - self._latency_frames - n_later)
        for phoneme, start in runs:
            if start < self._n_final:
                self._last_final, self._run_start = phoneme, start
        ends = [start for _, start in runs[1:]]
        return PhonemeUpdate(
            replace_from_s=n_final_before / self._frames_per_s,
            heard_until_s=n_heard / self._frames_per_s,
            final_until_s=self._n_final / self._frames_per_s,
            events=tuple(
                PhonemeEvent(
                    phoneme,
                    start / self._frames_per_s,
                    None if end is None else end / self._frames_per_s,
                )
                for (phoneme, start), end in zip(runs, [*ends, None], strict=True)
            ),
        )

    def _runs(self, phonemes: Sequence[str]) -> list[tuple[str, int]]:
        """Return (phoneme, first frame) of each run of equal phonemes.

        phonemes: of the frames from the first that is not final. Where the first run continues the
        last final phoneme, its first frame is where that phoneme began.
        """
        runs, start = [], self._n_final
        for phoneme, frames in groupby(phonemes):
            goes_on = start == self._n_final > 0 and phoneme == self._last_final
            runs.append((phoneme, self._run_start if goes_on else start))
            start += len(list(frames))
        return runs
