"""Reading of health logs: figures of each servo day by day, and sentences on what gets worse."""

import json
import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date
from itertools import combinations
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.bus import describe_errors
from lipservo.health.health_log import DAY_FILE
from lipsync.arrays import Array

_QUANTITIES = ("temperature_degc", "load", "voltage_v", "current_ma", "errors", "torque_on")
_COUNTS = ("reboots", "unanswered")
#: A day counts once a servo has held its place for five minutes of it (30 readings).
_FEWEST_READINGS = 30
#: A slope needs so many days, and older ones than these are history.
_FEWEST_DAYS, _MOST_DAYS = 4, 14
#: How much is worth a sentence. Ours: a room changes by less than 5 degC against its servos, and
#: the encoder of a thermometer that reads whole degrees flickers by one.
_WARMER_DEGC, _MORE_LOAD, _FEWER_V = 5.0, 0.08, 0.3
#: A change must stand out of the scatter of the days by this factor.
_ABOVE_SCATTER = 2.0
#: Errors and restarts are told for so many days.
_FRESH_DAYS = 3
#: Unanswered questions an hour that are many, and so many times those of the days before.
_MANY_PER_HOUR, _TIMES_BEFORE = 10.0, 3.0
_PERIOD_HOURS = 10.0 / 3600.0


@dataclass(frozen=True, slots=True)
class ServoDay:
    """The readings of one servo on one UTC day. NaN: not received, or not measured by its model.

    n_readings: with torque on, and only they make temperature_degc, load and current_ma, which are
    medians. n_reboots, n_unanswered: on this day.
    """

    day: date
    n_readings: int
    temperature_degc: float
    hottest_degc: float
    latest_degc: float
    load: float
    current_ma: float
    least_v: float
    errors: int
    n_reboots: int
    n_unanswered: int


@dataclass(frozen=True, slots=True)
class History:
    """The days of every servo of a face, in order. n_bad_lines: lines that could not be parsed."""

    servos: Mapping[str, Sequence[ServoDay]]
    n_readings: int
    n_bad_lines: int
    bad_files: tuple[str, ...]


@dataclass(slots=True)
class _Column:
    """The readings of one servo in the course of a day."""

    values: dict[str, list[float]] = field(
        default_factory=lambda: {name: [] for name in _QUANTITIES}
    )
    counts: Counter[str] = field(default_factory=Counter)


class _Counted:
    """A converter of counts since a run of the face began into counts since the previous record."""

    def __init__(self) -> None:
        self._number: float = -1.0
        self._last: dict[tuple[str, str], float] = {}
        self._began = False

    def news(
        self, record: Mapping[str, list[float]], names: list[str], number: float
    ) -> Counter[tuple[str, str]]:
        """Return how much each count rose since the last record, by servo and quantity.

        names: of the servos. number: of the record in its run, from 0. The first record of a log
        that begins in the middle of a run counts as no rise.
        """
        now = {
            (name, key): value
            for key in _COUNTS
            for name, value in zip(names, record[key], strict=True)
        }
        fresh = number <= self._number
        if not self._began and number > 0:
            self._last, fresh = now, False
        base = {} if fresh else self._last
        news = Counter(
            {each: max(0, int(value - base.get(each, 0))) for each, value in now.items()}
        )
        self._began, self._number, self._last = True, number, now
        return news


def day_files(folders: Iterable[Path], days: int) -> dict[date, list[Path]]:
    """Return the log files of the newest `days` days that have any, by day.

    Raises OSError for a folder that cannot be read.
    """
    found: dict[date, list[Path]] = {}
    for folder in folders:
        for path in sorted(folder.iterdir()):
            day = _day(path.name)
            if day is not None:
                found.setdefault(day, []).append(path)
    return {day: found[day] for day in sorted(found)[-days:]}


def _day(name: str) -> date | None:
    try:
        return date.fromisoformat(name[:10]) if DAY_FILE.fullmatch(name) else None
    except ValueError:
        return None


def read_history(folders: Iterable[Path], days: int) -> History:
    """Read the newest `days` days of the logs in folders; count bad lines, list bad files.

    Raises OSError for a folder that cannot be read.
    """
    servos: dict[str, list[ServoDay]] = {}
    n_readings = n_bad = 0
    bad_files: list[str] = []
    counted: dict[Path, _Counted] = {}
    for day, paths in day_files(folders, days).items():
        columns: dict[str, _Column] = {}
        for path in paths:
            counts = counted.setdefault(path.parent, _Counted())
            try:
                lines = path.read_bytes().split(b"\n")
            except OSError as error:
                bad_files.append(f"{path}: {error.strerror}")
                continue
            good, bad = _read_lines(lines, columns, counts)
            n_readings, n_bad = n_readings + good, n_bad + bad
        for servo, column in columns.items():
            servos.setdefault(servo, []).append(_summarize(day, column))
    return History(servos, n_readings, n_bad, tuple(bad_files))


def _read_lines(
    lines: Iterable[bytes], columns: dict[str, _Column], counted: _Counted
) -> tuple[int, int]:
    """Add log lines to `columns`, by servo; return (lines parsed, lines not parsed).

    counted: converts counts since the run began into those of each line.
    """
    good = bad = 0
    for line in lines:
        if not line.strip():
            continue
        try:
            names, number, record = _parse(line)
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
            bad += 1
            continue
        good += 1
        news = counted.news(record, names, number)
        for index, name in enumerate(names):
            column = columns.setdefault(name, _Column())
            for key in _QUANTITIES:
                column.values[key].append(record[key][index])
            for key in _COUNTS:
                column.counts[key] += news[name, key]
    return good, bad


def _parse(line: bytes) -> tuple[list[str], float, dict[str, list[float]]]:
    """Parse a log line to (servo names, number in its run, values by quantity).

    Raises ValueError, TypeError, KeyError, and what damaged JSON and numbers raise.
    """
    raw = json.loads(line)
    names = raw["servos"]
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ValueError("the servos' names are missing")
    columns = {key: [_float(value) for value in raw[key]] for key in (*_QUANTITIES, *_COUNTS)}
    if any(len(column) != len(names) for column in columns.values()):
        raise ValueError("its columns differ in length")
    if not all(math.isfinite(value) for key in (*_COUNTS, "errors") for value in columns[key]):
        raise ValueError("a count is not a finite number")
    if not all(0 <= bits <= 255 for bits in columns["errors"]):
        raise ValueError("an error byte is outside 0..255")
    return names, _float(raw["number"]), columns


def _float(value: object) -> float:
    if value is None:
        return math.nan
    if not isinstance(value, int | float):
        raise TypeError(f"{value!r} is not a number")
    return float(value)


def _summarize(day: date, column: _Column) -> ServoDay:
    """Return a servo's figures of one day; NaN for a quantity without readings.

    The medians (load, current, temperature) are of readings with torque on; extremes, the latest
    temperature, error bits and counts are of all.
    """
    values = {key: np.array(list_) for key, list_ in column.values.items()}
    on = values["torque_on"] > 0
    warm = values["temperature_degc"]
    errors = 0
    for bits in set(values["errors"].astype(int).tolist()):
        errors |= bits
    return ServoDay(
        day=day,
        n_readings=int(on.sum()),
        temperature_degc=_of(np.median, warm[on]),
        hottest_degc=_of(np.max, warm),
        latest_degc=next((float(each) for each in warm[::-1] if math.isfinite(each)), math.nan),
        load=_of(np.median, values["load"][on]),
        current_ma=_of(np.median, values["current_ma"][on]),
        least_v=_of(np.min, values["voltage_v"]),
        errors=errors,
        n_reboots=column.counts["reboots"],
        n_unanswered=column.counts["unanswered"],
    )


def _of(function: Callable[[Array], np.float64], values: Array) -> float:
    """Return `function` applied to the finite values; NaN if there are none."""
    heard = values[np.isfinite(values)]
    return float(function(heard)) if len(heard) else math.nan


def findings(servos: Mapping[str, Sequence[ServoDay]]) -> list[str]:
    """Return a sentence with remedy for each problem of servos, given by name; urgent first."""
    shared = _shared_warmth(servos)
    lines = [line for name, days in servos.items() for line in _troubles(name, days)]
    rise = _change(shared)
    if len(servos) > 1 and rise is not None and rise[0] >= _WARMER_DEGC:
        lines.append(
            f"all servos run {rise[0]:.0f} degC warmer than {_ago(rise[1])}: a warmer room, less "
            "air around them, or a supply set too high"
        )
    for name, days in servos.items():
        lines += _trends(name, days, shared if len(servos) > 2 else {})
    return lines


def theil_sen_slope(times: NDArray[np.float64], values: NDArray[np.float64]) -> float:
    """Return the median of the slopes of all pairs: Sen, J. Am. Stat. Assoc. 63 (1968) 1379.

    Parameters
    ----------
    times : NDArray[np.float64]
        (n,), different.
    values : NDArray[np.float64]
        (n,).

    Returns
    -------
    float
        Slope in units of `values` for one unit of time.
    """
    slopes = [
        (values[j] - values[i]) / (times[j] - times[i])
        for i, j in combinations(range(len(times)), 2)
    ]
    return float(np.median(slopes))


def _troubles(name: str, days: Sequence[ServoDay]) -> list[str]:
    """Return a sentence each for recent errors, restarts and unanswered requests of a servo."""
    newest = days[-_FRESH_DAYS:]
    lines = []
    errors = 0
    for day in newest:
        errors |= day.errors
    if errors:
        when = ", ".join(f"{day.day}" for day in newest if day.errors)
        lines.append(
            f"{name} reported {describe_errors(errors)} ({when}): feel whether it is hot, move the "
            "joint by hand while limp, look at its supply"
        )
    reboots = sum(day.n_reboots for day in newest)
    if reboots:
        lines.append(
            f"{name} was restarted {reboots} times in its last {len(newest)} days: "
            "something in it or its supply is failing"
        )
    heard = [day for day in days if day.n_readings >= _FEWEST_READINGS]
    silence = [day.n_unanswered / (day.n_readings * _PERIOD_HOURS) for day in heard]
    if len(silence) > 1:
        before = float(np.median(silence[:-1]))
        if silence[-1] >= max(_MANY_PER_HOUR, _TIMES_BEFORE * before):
            lines.append(
                f"{name} left {silence[-1]:.0f} questions an hour unanswered, {before:.0f} before: "
                "look at its plug and cable, and at those before it in the chain"
            )
    return lines


def _trends(name: str, days: Sequence[ServoDay], shared: Mapping[date, float]) -> list[str]:
    """Return a sentence each for a servo that gets warmer, pulls harder, or gets less voltage.

    shared: by day, the warmth in degC that all servos have in common, which is subtracted; {}:
    none. Days with few readings are left out.
    """
    counted = [day for day in days if day.n_readings >= _FEWEST_READINGS]
    load = _change({day.day: day.load for day in counted})
    warmth = _change({day.day: day.temperature_degc - shared.get(day.day, 0.0) for day in counted})
    volts = _change({day.day: -day.least_v for day in counted})
    works_harder = load is not None and load[0] >= _MORE_LOAD
    lines = []
    if warmth is not None and warmth[0] >= _WARMER_DEGC:
        compared = ", compared with the others," if shared else ""
        why = (
            "under more load: a joint that binds, or a skin that pulls harder"
            if works_harder
            else "at the same load: look for a joint that binds, and for air"
        )
        lines.append(
            f"{name} runs {warmth[0]:.0f} degC warmer than {_ago(warmth[1])}{compared} {why}"
        )
    elif works_harder and load is not None:
        lines.append(
            f"{name} pulls {load[0]:.0%} of its stall torque more than {_ago(load[1])}: look for a "
            "joint that binds, and grease it"
        )
    if volts is not None and volts[0] >= _FEWER_V:
        lines.append(
            f"{name} gets {volts[0]:.1f} V less at worst than {_ago(volts[1])}: look at the "
            "supply, its plugs, and the cable along the chain"
        )
    return lines


def _change(values: Mapping[date, float]) -> tuple[float, int] | None:
    """Return (change, days from first to last) by the linear trend of a quantity by day.

    None if the change is within twice the scatter, and for too few days with a value.
    """
    known = sorted((day.toordinal(), v) for day, v in values.items() if math.isfinite(v))
    if len(known) < _FEWEST_DAYS:
        return None
    times, found = np.array(known[-_MOST_DAYS:]).T
    slope = theil_sen_slope(times, found)
    span = times[-1] - times[0]
    rest = found - slope * times
    scatter = float(np.median(np.abs(rest - np.median(rest))))
    change = slope * span
    return (change, int(span)) if abs(change) > _ABOVE_SCATTER * scatter else None


def _shared_warmth(servos: Mapping[str, Sequence[ServoDay]]) -> dict[date, float]:
    """Return the median temperature of all servos by day, degC: the room's share."""
    by_day: dict[date, list[float]] = {}
    for days in servos.values():
        for day in days:
            if day.n_readings >= _FEWEST_READINGS and math.isfinite(day.temperature_degc):
                by_day.setdefault(day.day, []).append(day.temperature_degc)
    return {day: float(np.median(list_)) for day, list_ in by_day.items()}


def _ago(days: int) -> str:
    return "a week ago" if days == 7 else f"{days} days ago"
