"""Targets on their way to the bridge, and what the bridge makes of them."""

import math
from bisect import bisect_left, bisect_right
from collections import deque
from collections.abc import Iterable

import numpy as np

from firmware_bridge.arrays import Array, all_set
from firmware_bridge.targets import ServoTargets

#: Longest step beyond the newest target along its slope. At the mouth's usual 5 Hz and below it is
#: a quarter of a cycle: the slope still tells the direction, later it does not.
MAX_EXTRAPOLATION_S = 0.050
#: Two targets closer than this say the same moment twice: a tenth of the 100 Hz spacing that the
#: speech side publishes at. It also keeps the slope from being a quotient of two rounding errors.
SAME_MOMENT_S = 0.001


class MemoryTargetChannel:
    """A `TargetChannel` inside one process and one thread: replay, tests, a face on this computer.

    Holds `capacity` records; publishing into a full channel drops the oldest.
    """

    def __init__(self, capacity: int = 32) -> None:
        self._records: deque[ServoTargets] = deque(maxlen=capacity)
        self._n_dropped = 0

    @property
    def n_dropped(self) -> int:
        """Records that were overwritten before anyone drained them."""
        return self._n_dropped

    def publish(self, targets: ServoTargets) -> None:
        """Hand over one target record."""
        if len(self._records) == self._records.maxlen:
            self._n_dropped += 1
        self._records.append(targets)

    def drain(self) -> list[ServoTargets]:
        """All records published since the last call that were not dropped, oldest first."""
        records = list(self._records)
        self._records.clear()
        return records


class TargetTrack:
    """The newest targets in order of display time, read as one continuous motion.

    A record says what holds from its time on: it replaces every kept one at or after that time, so
    a speech side that thinks again, or starts again, is never mixed with what it said before.
    Records with the wrong number of joints, or anything not finite, are left out and counted.
    """

    def __init__(self, n_servos: int, n_kept: int = 256) -> None:
        """Keep `n_kept` records: 2.5 s at 100 Hz, more than any target is dated ahead."""
        self._shape = (n_servos,)
        self._n_kept = n_kept
        self._times_s: list[float] = []
        self._positions_deg: list[Array] = []
        self._n_rejected = 0

    @property
    def n_rejected(self) -> int:
        """Records left out because they were invalid."""
        return self._n_rejected

    def push(self, records: Iterable[ServoTargets]) -> None:
        """Take records in the order they were published."""
        for record in records:
            if self._is_valid(record):
                self._keep(record)
            else:
                self._n_rejected += 1

    def at(self, time_s: float) -> tuple[Array | None, float]:
        """Positions for `time_s`, (n_servos,), and the age of the newest target due by then.

        Linear between targets; beyond the newest along its last slope for `MAX_EXTRAPOLATION_S`,
        then held. Targets not yet due count for nothing in the age: a sender that dates them into
        the far future has gone quiet. Before the first is due: (None, infinity).
        """
        n_due = bisect_right(self._times_s, time_s)
        if n_due == 0:
            return None, float("inf")
        age_s = time_s - self._times_s[n_due - 1]
        if n_due < len(self._times_s):
            return self._on_line(n_due - 1, time_s), age_s
        if n_due == 1:
            return self._positions_deg[0], age_s
        return self._on_line(n_due - 2, time_s - max(0.0, age_s - MAX_EXTRAPOLATION_S)), age_s

    def _is_valid(self, record: ServoTargets) -> bool:
        return (
            record.positions_deg.shape == self._shape
            and math.isfinite(record.time_s)
            and all_set(np.isfinite(record.positions_deg))
        )

    def _keep(self, record: ServoTargets) -> None:
        times_s = self._times_s
        if not times_s or times_s[-1] < record.time_s - SAME_MOMENT_S:  # nearly always so
            times_s.append(record.time_s)
            self._positions_deg.append(record.positions_deg)
        else:
            self._replace_from(record)
        if len(times_s) > self._n_kept:
            del times_s[0], self._positions_deg[0]

    def _replace_from(self, record: ServoTargets) -> None:
        replaced = bisect_left(self._times_s, record.time_s - SAME_MOMENT_S)
        self._times_s[replaced:] = [record.time_s]
        self._positions_deg[replaced:] = [record.positions_deg]

    def _on_line(self, left: int, time_s: float) -> Array:
        """Follow the straight line through targets `left` and `left + 1`, at `time_s`."""
        start_s, end_s = self._times_s[left], self._times_s[left + 1]
        start_deg, end_deg = self._positions_deg[left], self._positions_deg[left + 1]
        return start_deg + (end_deg - start_deg) * ((time_s - start_s) / (end_s - start_s))
