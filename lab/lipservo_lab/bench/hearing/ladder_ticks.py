"""The ticks of a face under load, from its trace, and what they amount to."""

import json
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array
from lipsync.audio_block import BLOCK_S
from lipsync.errors import UserError
from lipsync.face.model import load_face

RATE_HZ: Final = 100.0
#: In each minute: when a load begins, and how long it lasts.
LOADS_S: Final = ((8.0, 1.0), (22.0, 2.0), (38.0, 5.0))
#: Loads that should not take the network away.
_SHORT_S: Final = 2.0
#: Around a change the mouth is looked at for so long.
_AROUND_S: Final = 0.02


class LadderError(UserError):
    """A process that was to be measured did not work; one line."""


@dataclass(frozen=True, slots=True)
class Load:
    """Every core was busy from and to these monotonic times; length_s: as scripted."""

    begin_s: float
    end_s: float
    length_s: float


@dataclass(frozen=True, slots=True)
class Ticks:
    """The ticks of a trace, (n,) each, by monotonic time.

    heard_s: the sound time heard then; shown_s: the one shown. is_network: whether it listens.
    over_s: how much later than declared its targets are. gap_mm: between the lips. late: ticks
    missed before.
    """

    time_s: Array
    heard_s: Array
    shown_s: Array
    is_network: NDArray[np.bool_]
    over_s: Array
    gap_mm: Array
    late: NDArray[np.int64]

    def until(self, sound_s: float) -> "Ticks":
        """Those in which the sound before `sound_s` was heard; afterwards the face is let go."""
        kept = self.heard_s < sound_s
        return Ticks(*(getattr(self, each.name)[kept] for each in fields(self)))


def read_ticks(trace: Path, first_s: float) -> Ticks:
    """The ticks of a trace whose first was at monotonic `first_s`. Raises LadderError."""
    face = load_face()
    columns: list[tuple[float, float, bool, float, float, int]] = []
    try:
        with trace.open(encoding="utf-8") as file:
            delay_s = float(json.loads(file.readline())["delay_s"])
            n = 0
            for line in file:
                record: dict[str, Any] = json.loads(line)
                if "ticks" in record:
                    continue
                n += record["late"]
                columns.append(
                    (
                        first_s + n / RATE_HZ,
                        record["sound_s"],
                        record["hears"] is not None,
                        record["target_age_s"] or 0.0,
                        face.lip_gap_mm(np.array(record["coefficients"])),
                        record["late"],
                    )
                )
                n += 1
    except (OSError, ValueError, KeyError) as error:
        raise LadderError(f"{trace.name}: no trace of a whole run ({error})") from error
    if not columns:
        raise LadderError(f"{trace.name}: holds no tick")
    times_s, shown_s, networks, overs_s, gaps_mm, late = (
        np.array(each) for each in zip(*columns, strict=True)
    )
    return Ticks(times_s, shown_s + delay_s, shown_s, networks, overs_s, gaps_mm, late)


def figures_of(
    ticks: Ticks, loads: Sequence[Load], is_speech: NDArray[np.bool_]
) -> dict[str, object]:
    """What the ticks amount to. is_speech: for each 10 ms of the sound, over and over."""
    weights = 1 + ticks.late
    frame = np.floor(np.maximum(ticks.heard_s, 0.0) / BLOCK_S).astype(np.int64)
    speaks = is_speech[frame % len(is_speech)] & (ticks.heard_s >= 0.0)
    network_share = float((weights * ticks.is_network)[speaks].sum() / weights[speaks].sum())
    backs_s: list[float] = []
    left: dict[float, int] = {length_s: 0 for _, length_s in LOADS_S}
    over_ms: list[float] = []
    ends_s = [*(load.begin_s for load in loads[1:]), float("inf")]
    for load, until_s in zip(loads, ends_s, strict=True):
        within = (ticks.time_s >= load.begin_s) & (ticks.time_s < until_s)
        away_s = ticks.time_s[within & ~ticks.is_network]
        if len(away_s):
            left[load.length_s] += 1
            backs_s.append(max(0.0, float(away_s[-1]) - load.end_s))
        for index in np.flatnonzero(within & (ticks.time_s < load.end_s)).tolist():
            missed = np.arange(ticks.late[index] + 1) / RATE_HZ
            over_ms += (1e3 * (ticks.over_s[index] + missed)).tolist()
    # Over missed ticks it is spread: how late the mouth is, is a figure of its own.
    steps_mm = np.abs(np.diff(ticks.gap_mm, prepend=ticks.gap_mm[:1])) / weights
    at_change = _near_changes(ticks)
    return {
        "network_share": network_share,
        "back_median_s": statistics.median(backs_s) if backs_s else 0.0,
        "back_worst_s": max(backs_s, default=0.0),
        "delay_over_p99_ms": float(np.percentile(over_ms, 99)) if over_ms else 0.0,
        "widest_step_mm": float(steps_mm[at_change].max()) if at_change.any() else 0.0,
        "widest_step_in_speech_mm": float(steps_mm[~at_change].max()),
        "loads": len(loads),
        "left_by_loads": sum(left.values()),
        "left_by_loads_up_to_2_s": sum(n for s, n in left.items() if s <= _SHORT_S),
        "changes": int(np.count_nonzero(np.diff(ticks.is_network))),
        "late_ticks": int(ticks.late.sum()),
    }


def _near_changes(ticks: Ticks) -> NDArray[np.bool_]:
    """Ticks that show the mouth at a change.

    When it happens, as what is planned may change then; and where phonemes of the one recogniser
    meet those of the other: at the sound heard then, less what the recogniser waits.
    """
    near = np.zeros(len(ticks.time_s), np.bool_)
    for index in np.flatnonzero(np.diff(ticks.is_network)) + 1:
        near |= np.abs(ticks.time_s - ticks.time_s[index]) <= _AROUND_S
        met_s = ticks.heard_s[index]
        near |= (ticks.shown_s >= met_s - 0.1 - _AROUND_S) & (ticks.shown_s <= met_s + _AROUND_S)
    return near
