"""A loudspeaker without sound, on a virtual clock: its rate is a little wrong, its reports too.

What of the timeline left it when is recorded, so that lips can be compared with what was truly
played.
"""

import numpy as np
from numpy.typing import NDArray

from lipsync.audio.position_report import PositionReport
from lipsync.audio.sample_ring import SampleRing

Samples = NDArray[np.float32]
Seconds = NDArray[np.float64]


class SimulatedLoudspeaker:
    """A `lipsync.audio.playout.Loudspeaker`; `advance` lets time pass.

    rate_hz: samples a second, a multiple of 100, by its own clock. latency_s: from its taking a
    sample to the sample's leaving it. skew: how much faster than said its clock runs, 200e-6 for
    200 parts in a million. jitter_s: its reports are up to so much early or late, evenly spread,
    and its callbacks come up to so much late, by `rng`.
    """

    def __init__(
        self,
        rate_hz: int = 48_000,
        latency_s: float = 0.05,
        skew: float = 0.0,
        jitter_s: float = 0.0,
        rng: np.random.Generator | None = None,
    ) -> None:
        self._ring = SampleRing(rate_hz)
        self._latency_s = latency_s
        self._period_s = 0.01 / (1.0 + skew)
        self._jitter_s = jitter_s
        self._rng = np.random.default_rng(0) if rng is None else rng
        self._frames: Samples = np.zeros((rate_hz // 100, 1), dtype=np.float32)
        self._report: PositionReport | None = None
        self._now_s = 0.0
        self._due_s: float | None = None  # when it asks for the next block, by its clock
        self._late_s = 0.0  # so much later the callback comes
        self._stalls: list[tuple[float, float]] = []
        self._played: list[tuple[float, Samples]] = []

    #: It cannot be lost, only stand still.
    is_lost = False
    name = "simulated loudspeaker"
    n_device_underruns = 0

    @property
    def rate_hz(self) -> int:
        """Samples a second, by its own clock."""
        return self._ring.rate_hz

    @property
    def latency_s(self) -> float:
        """The lead must be at least this: its latency, a block of 10 ms, and its jitter."""
        return self._latency_s + 0.01 + self._jitter_s

    @property
    def n_underruns(self) -> int:
        """How often nothing was written in time while it asked for more."""
        return self._ring.n_underruns

    def write(self, samples: Samples) -> None:
        """The next samples (n,) float32 mono of the timeline."""
        self._ring.write(samples)

    def silence_rest(self) -> float:
        """As `LoudspeakerOutput.silence_rest`."""
        return self._ring.silence_rest(self.rate_hz // 100) / self.rate_hz

    def position(self) -> tuple[float, float] | None:
        """(monotonic seconds, timeline seconds that leave it then): in error by the jitter."""
        return None if self._report is None else self._report.at(self._now_s)

    def stall(self, from_s: float, until_s: float) -> None:
        """From one moment to the other it takes nothing and plays nothing."""
        self._stalls.append((from_s, until_s))

    def advance(self, now_s: float) -> None:
        """Take what it asks for until monotonic `now_s`. The first call begins its time."""
        self._now_s = now_s
        if self._due_s is None:
            self._due_s = now_s
        while self._due_s + self._late_s <= now_s:
            self._due_s = self._after_stalls(self._due_s)
            if self._due_s + self._late_s > now_s:
                return
            self._take(self._due_s)
            self._due_s += self._period_s
            self._late_s = self._jitter_s * float(self._rng.random())

    def played(self) -> tuple[Samples, Seconds]:
        """The samples (n,) of the timeline that it has taken, and when each leaves it (n,).

        Zeros that it played for want of samples are not among them.
        """
        if not self._played:
            return np.zeros(0, dtype=np.float32), np.zeros(0)
        sample_s = self._period_s * 100.0 / self.rate_hz
        times_s = [begins_s + sample_s * np.arange(len(each)) for begins_s, each in self._played]
        return np.concatenate([each for _, each in self._played]), np.concatenate(times_s)

    def _after_stalls(self, due_s: float) -> float:
        for from_s, until_s in sorted(self._stalls):
            if from_s <= due_s < until_s:
                due_s = until_s
        return due_s

    def _take(self, asked_s: float) -> None:
        position_s = self._ring.n_taken / self.rate_hz
        n = self._ring.take_into(self._frames)
        leaves_s = asked_s + self._latency_s
        error_s = self._jitter_s * (2.0 * float(self._rng.random()) - 1.0)
        told_s = leaves_s + error_s
        end_position_s = position_s + n / self.rate_hz
        self._report = PositionReport(
            told_s, position_s, told_s + self._period_s + self._jitter_s, end_position_s
        )
        if n:
            self._played.append((leaves_s, self._frames[:n, 0].copy()))
