"""The one way to run a recogniser over a stream of sound: live, in replay, and when measured.

`RecognizerStream` feeds blocks, collects what became known, takes the time, and tells observers.
`SoundAhead` hands out a source's blocks at their times; where nobody waits for a tick it shows the
recogniser much sound at once before, which is cheaper and changes nothing of what is told when.
"""

import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from lipsync.audio.cutter import BLOCK_SAMPLES
from lipsync.audio.source import AudioSource
from lipsync.audio_block import SAMPLE_RATE_HZ, AudioBlock, samples_before
from lipsync.phonemes import LiveRecognizer, PhonemeUpdate


@runtime_checkable
class PreparingRecognizer(LiveRecognizer, Protocol):
    """A recogniser that can do a part of its work before the time of the sound has come."""

    @property
    def ahead_s(self) -> float:
        """How much sound `prepare` is best given at once; 0: none, somebody waits for each tick."""

    def prepare(self, blocks: Sequence[AudioBlock]) -> None:
        """Work on the blocks that will be fed next, one by one.

        What `updates` gives depends on what was fed, not on what was prepared.
        """


@runtime_checkable
class BacklogRecognizer(LiveRecognizer, Protocol):
    """A recogniser that wants to see at once all that waits for it."""

    def feed_all(self, blocks: Sequence[AudioBlock]) -> None:
        """Hear blocks that follow each other, the oldest first."""


@dataclass(frozen=True, slots=True)
class StreamStep:
    """What one step of a stream brought.

    blocks: what was fed; updates: what became known by it; cost_s: processor time of this thread,
    0 where nobody observes (reading that clock is a system call).
    """

    blocks: Sequence[AudioBlock]
    updates: Sequence[PhonemeUpdate]
    cost_s: float


class StreamObserver(Protocol):
    """Sees every step of a stream, in order."""

    def observe(self, step: StreamStep) -> None:
        """Take note of one step."""


class RecognizerStream:
    """Feeds a recogniser step by step."""

    def __init__(
        self,
        recognizer: LiveRecognizer,
        observers: Sequence[StreamObserver] = (),
        clock_ns: Callable[[], int] = time.thread_time_ns,
    ) -> None:
        """clock_ns: what costs are counted in; other programs' load is no cost of ours."""
        self._recognizer = recognizer
        self._backlog = recognizer if isinstance(recognizer, BacklogRecognizer) else None
        self._observers = tuple(observers)
        self._clock_ns = clock_ns

    def feed(self, blocks: Sequence[AudioBlock]) -> StreamStep:
        """Feed the blocks, ask once for updates, and tell the observers."""
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
    """A source's blocks at their times; a `PreparingRecognizer` is shown them before.

    Of a live source nothing is known ahead, and nothing is prepared.
    """

    def __init__(self, source: AudioSource, recognizer: LiveRecognizer) -> None:
        self._source = source
        self._preparing = (
            recognizer
            if isinstance(recognizer, PreparingRecognizer) and not source.is_live
            else None
        )
        self._shown_until_s = 0.0
        self._waiting: deque[AudioBlock] = deque()

    def blocks(self, until_s: float) -> list[AudioBlock]:
        """The blocks not handed out before that end at or before sound time `until_s`."""
        if self._preparing is not None and until_s > self._shown_until_s:
            ahead_s = self._preparing.ahead_s
            if ahead_s > 0.0:
                self._shown_until_s = until_s + ahead_s
                shown = self._source.blocks(self._shown_until_s)
                self._preparing.prepare(shown)
                self._waiting.extend(shown)
        n_due = samples_before(until_s)
        due = []
        while self._waiting and round(self._waiting[0].end_s * SAMPLE_RATE_HZ) <= n_due:
            due.append(self._waiting.popleft())
        return due if self._waiting else due + self._source.blocks(until_s)


def blocks_of(
    samples: NDArray[np.float32], n_first: int = BLOCK_SAMPLES, n_block: int = BLOCK_SAMPLES
) -> Iterator[AudioBlock]:
    """Samples (n,) at 16 kHz as blocks of `n_block` from sound time 0; the first of `n_first`.

    What is left at the end is the last, shorter block.
    """
    edges = [0, *range(n_first, len(samples), n_block), len(samples)]
    for start, end in pairwise(edges):
        yield AudioBlock(samples[start:end], start / SAMPLE_RATE_HZ)
