"""A face with a ladder of recognisers, by a clock of its own.

Sound comes by it, work takes it as much as a script says, and other programs may take all of it.
"""

import math
from itertools import pairwise

from logged import logged

from lipsync.audio_block import BLOCK_S, AudioBlock
from lipsync.recognition.energy_recognizer import EnergyRecognizer
from lipsync.recognition.fallback import FallbackLevel, FallbackRecognizer
from lipsync.recognition.network_recognizer import NetworkRecognizer
from lipsync.recognition.streaming import RecognizerStream
from lipsync.timeline import PhonemeTimeline

FALLBACK = "lipsync.recognition.fallback"
LATENCY_S = 0.095
#: What a second of sound takes of a core here (docs/benchmarks.md).
USUAL = 0.05


class Computer:
    """Time, and who has the processor.

    share: what a second of sound takes the network. busy: (from, to) when other programs have the
    processor. slower: what everything takes more of between (from, to, times).
    """

    def __init__(self, share=USUAL, busy=(), slower=()):
        self.now_s = 0.0
        self.share, self.busy, self.slower = share, busy, slower
        self.n_worked = 0

    def work(self, seconds):
        for begin_s, end_s, times in self.slower:
            if begin_s <= self.now_s < end_s:
                seconds *= times
        self.wait_until(self.now_s + seconds)

    def wait_until(self, time_s):
        self.now_s = max(self.now_s, time_s)
        for begin_s, end_s in self.busy:
            if begin_s <= self.now_s < end_s:
                self.now_s = end_s


class Network(NetworkRecognizer):
    """The real one, which takes the time that the computer says."""

    def __init__(self, computer, weights):
        super().__init__(weights)
        self.computer = computer
        self.n_heard_blocks = 0

    def prepare(self, blocks):
        self.n_heard_blocks += len(blocks)
        self.computer.work(self.computer.share * BLOCK_S * len(blocks))
        super().prepare(blocks)


class Cheap(EnergyRecognizer):
    """In the place of the network, so that many cases take little time."""

    latency_s = LATENCY_S

    def __init__(self, computer, _weights):
        self.computer = computer
        super().__init__()

    def feed(self, block):
        self.computer.work(self.computer.share * BLOCK_S)
        super().feed(block)


class Face:
    """A recogniser with the ladder, in a loop at 100 Hz that falls behind as a real one does."""

    def __init__(self, computer, samples, weights, start_s=0.0, make=Network):
        self.computer, self.samples, self.start_s = computer, samples, start_s
        computer.now_s = start_s
        self.networks = []

        def network():
            self.networks.append(make(computer, weights))
            return self.networks[-1]

        with logged(FALLBACK) as self.changes:
            self.recognizer = FallbackRecognizer(
                [FallbackLevel("network", network), FallbackLevel("energy", EnergyRecognizer)],
                LATENCY_S,
                timer_s=lambda: computer.now_s,
            )
        self.stream = RecognizerStream(self.recognizer)
        self.timeline = PhonemeTimeline(horizon_s=math.inf)
        self.n_handed = round(start_s / BLOCK_S)
        self.levels = []  # (time, level) at each tick
        self.updates = []

    def live_until(self, time_s, on_tick=lambda: None):
        tick = round(self.computer.now_s / BLOCK_S)
        while self.computer.now_s < time_s:
            n_due = math.floor((self.computer.now_s - self.start_s) / BLOCK_S + 1e-6)
            n_due += round(self.start_s / BLOCK_S)
            with logged(FALLBACK, self.changes.append):
                step = self.stream.feed([self.block(n) for n in range(self.n_handed, n_due)])
            self.n_handed = n_due
            for update in step.updates:
                self.timeline.apply(update)
            self.updates += step.updates
            self.levels.append((self.computer.now_s, self.recognizer.level))
            on_tick()
            tick = max(tick + 1, math.floor(self.computer.now_s / BLOCK_S) + 1)
            self.computer.wait_until(tick * BLOCK_S)

    def block(self, n):
        first = n * 160 % len(self.samples)
        return AudioBlock(self.samples[first : first + 160], n * BLOCK_S)

    def when(self, level):
        """The times at which the recogniser changed to this level."""
        return [
            now for (_, before), (now, after) in pairwise(self.levels) if before != after == level
        ]
