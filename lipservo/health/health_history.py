"""Reading of health logs: figures of each servo day by day, and sentences on what gets worse."""

import json
import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date
from functools import reduce
from itertools import combinations
from operator import or_
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
_RECENT_DAYS = 3
#: Unanswered questions an hour that are many, and so many times those of the days before.
_MANY_PER_HOUR, _TIMES_AS_BEFORE = 10.0, 3.0
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
class _DayReadings:
    """The readings of one servo in the course of a day."""

    values: dict[str, list[float]] = field(
        default_factory=lambda: {name: [] for name in _QUANTITIES}
    )
    counts: Counter[str] = field(default_factory=Counter)
    is_on: bool = False


class _CountRises:
    """A converter of counts since a run of the face began into counts since the previous record."""

    def __init__(self) -> None:
        self._last_number: float = -1.0
        self._last_counts: dict[tuple[str, str], float] = {}
        self._has_record = False

    def rises(
        self, record: Mapping[str, list[float]], names: list[str], number: float
    ) -> Counter[tuple[str, str]]:
        """Return how much each count rose since the last record, by servo and quantity.

        names: of the servos. number: of the record in its run, from 0; a number that is not higher
        than the last begins a new run, in which counts begin at 0. The first record of a log that
        begins in the middle of a run counts as no rise.
        """
        counts = {
            (name, key): value
            for key in _COUNTS
            for name, value in zip(names, record[key], strict=True)
        }
        is_new_run = number <= self._last_number
        if not self._has_record and number > 0:
            self._last_counts, is_new_run = counts, False
        base = {} if is_new_run else self._last_counts
        news = Counter(
            {each: max(0, int(value - base.get(each, 0))) for each, value in counts.items()}
        )
        self._has_record, self._last_number, self._last_counts = True, number, counts
        return news


def day_files(folders: Iterable[Path], days: int) -> dict[date, list[Path]]:
    """Return the log files of the newest `days` days that have any, by day.

    Raises OSError for a folder that cannot be read.
    """
    files_by_day: dict[date, list[Path]] = {}
    for folder in folders:
        for path in sorted(folder.iterdir()):
            day = _day_of_file(path.name)
            if day is not None:
                files_by_day.setdefault(day, []).append(path)
    return {day: files_by_day[day] for day in sorted(files_by_day)[-days:]}


def _day_of_file(name: str) -> date | None:
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
    count_rises: dict[Path, _CountRises] = {}
    for day, paths in day_files(folders, days).items():
        readings: dict[str, _DayReadings] = {}
        for path in paths:
            rises = count_rises.setdefault(path.parent, _CountRises())
            try:
                lines = path.read_bytes().split(b"\n")
            except OSError as error:
                bad_files.append(f"{path}: {error.strerror}")
                continue
            good, bad = _read_lines(lines, readings, rises)
            n_readings, n_bad = n_readings + good, n_bad + bad
        for servo, column in readings.items():
            servos.setdefault(servo, []).append(_summarize(day, column))
    return History(servos, n_readings, n_bad, tuple(bad_files))


def _read_lines(
    lines: Iterable[bytes], readings: dict[str, _DayReadings], count_rises: _CountRises
) -> tuple[int, int]:
    """Add log lines to `readings`, by servo; return (lines parsed, lines not parsed).

    count_rises: converts counts since the run began into the rise since the previous line.
    """
    n_good = n_bad = 0
    for line in lines:
        if not line.strip():
            continue
        try:
            names, number, record = _parse_line(line)
        except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
            n_bad += 1
            continue
        n_good += 1
        rises = count_rises.rises(record, names, number)
        for index, name in enumerate(names):
            of_servo = readings.setdefault(name, _DayReadings())
            for key in _QUANTITIES:
                of_servo.values[key].append(record[key][index])
            of_servo.is_on = bool(np.nan_to_num(record["torque_on"][index], nan=of_servo.is_on))
            for key in _COUNTS:
                # A servo known as limp last may be without supply: its silence is no fault.
                if key != "unanswered" or of_servo.is_on:
                    of_servo.counts[key] += rises[name, key]
    return n_good, n_bad


def _parse_line(line: bytes) -> tuple[list[str], float, dict[str, list[float]]]:
    """Parse a log line to (servo names, number in its run, values by quantity).

    Raises ValueError, TypeError, KeyError, and what damaged JSON and numbers raise.
    """
    content = json.loads(line)
    names = content["servos"]
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ValueError("the servos' names are missing")
    columns = {key: [_float(value) for value in content[key]] for key in (*_QUANTITIES, *_COUNTS)}
    if any(len(column) != len(names) for column in columns.values()):
        raise ValueError("its columns differ in length")
    if not all(math.isfinite(value) for key in (*_COUNTS, "errors") for value in columns[key]):
        raise ValueError("a count is not a finite number")
    if not all(0 <= bits <= 255 for bits in columns["errors"]):
        raise ValueError("an error byte is outside 0..255")
    return names, _float(content["number"]), columns


def _float(value: object) -> float:
    if value is None:
        return math.nan
    if not isinstance(value, int | float):
        raise TypeError(f"{value!r} is not a number")
    return float(value)


def _summarize(day: date, readings: _DayReadings) -> ServoDay:
    """Return a servo's figures of one day; NaN for a quantity without readings.

    The medians (load, current, temperature) are of readings with torque on; extremes, the latest
    temperature, error bits and counts are of all.
    """
    values = {key: np.array(series) for key, series in readings.values.items()}
    is_on = values["torque_on"] > 0
    warm = values["temperature_degc"]
    return ServoDay(
        day=day,
        n_readings=int(is_on.sum()),
        temperature_degc=_of_finite(np.median, warm[is_on]),
        hottest_degc=_of_finite(np.max, warm),
        latest_degc=next((float(each) for each in warm[::-1] if math.isfinite(each)), math.nan),
        load=_of_finite(np.median, values["load"][is_on]),
        current_ma=_of_finite(np.median, values["current_ma"][is_on]),
        least_v=_of_finite(np.min, values["voltage_v"]),
        errors=int(np.bitwise_or.reduce(values["errors"].astype(int))),
        n_reboots=readings.counts["reboots"],
        n_unanswered=readings.counts["unanswered"],
    )


def _of_finite(function: Callable[[Array], np.float64], values: Array) -> float:
    """Return `function` applied to the finite values; NaN if there are none."""
    finite = values[np.isfinite(values)]
    return float(function(finite)) if len(finite) else math.nan


def errors_of(days: Sequence[ServoDay]) -> int:
    """Return the error bits that a servo has reported on any of these days."""
    return reduce(or_, (day.errors for day in days), 0)


def findings(servos: Mapping[str, Sequence[ServoDay]]) -> list[str]:
    """Return a sentence with remedy for each problem of servos, given by name; urgent first."""
    shared_degc = _shared_warmth(servos)
    lines = [line for name, days in servos.items() for line in _failure_lines(name, days)]
    rise = _trend(shared_degc)
    if len(servos) > 1 and rise is not None and rise[0] >= _WARMER_DEGC:
        lines.append(
            f"all servos run {rise[0]:.0f} degC warmer than {_ago(rise[1])}: a warmer room, less "
            "air around them, or a supply set too high"
        )
    for name, days in servos.items():
        lines += _trend_lines(name, days, shared_degc if len(servos) > 2 else {})
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


def _failure_lines(name: str, days: Sequence[ServoDay]) -> list[str]:
    """Return a sentence each for recent errors, restarts and unanswered requests of a servo."""
    recent = days[-_RECENT_DAYS:]
    lines = []
    if errors := errors_of(recent):
        when = ", ".join(f"{day.day}" for day in recent if day.errors)
        lines.append(
            f"{name} reported {describe_errors(errors)} ({when}): feel whether it is hot, move the "
            "joint by hand while limp, look at its supply"
        )
    reboots = sum(day.n_reboots for day in recent)
    if reboots:
        lines.append(
            f"{name} was restarted {reboots} times in its last {len(recent)} days: "
            "something in it or its supply is failing"
        )
    full_days = [day for day in days if day.n_readings >= _FEWEST_READINGS]
    per_hour = [day.n_unanswered / (day.n_readings * _PERIOD_HOURS) for day in full_days]
    if len(per_hour) > 1:
        usual = float(np.median(per_hour[:-1]))
        if per_hour[-1] >= max(_MANY_PER_HOUR, _TIMES_AS_BEFORE * usual):
            lines.append(
                f"{name} left {per_hour[-1]:.0f} questions an hour unanswered, {usual:.0f} before: "
                "look at its plug and cable, and at those before it in the chain"
            )
    return lines


def _trend_lines(name: str, days: Sequence[ServoDay], shared: Mapping[date, float]) -> list[str]:
    """Return a sentence each for a servo that gets warmer, pulls harder, or gets less voltage.

    shared: by day, the temperature in degC that all servos have in common, which is subtracted; {}:
    none. Days with few readings are left out.
    """
    full_days = [day for day in days if day.n_readings >= _FEWEST_READINGS]
    # Each a change and the days that it took; None: no clear change.
    load = _trend({day.day: day.load for day in full_days})
    warmth = _trend({day.day: day.temperature_degc - shared.get(day.day, 0.0) for day in full_days})
    drop = _trend({day.day: -day.least_v for day in full_days})
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
    if drop is not None and drop[0] >= _FEWER_V:
        lines.append(
            f"{name} gets {drop[0]:.1f} V less at worst than {_ago(drop[1])}: look at the "
            "supply, its plugs, and the cable along the chain"
        )
    return lines


def _trend(values: Mapping[date, float]) -> tuple[float, int] | None:
    """Return (change, days from first to last) by the linear trend of a quantity by day.

    None if the change is within twice the scatter, and for too few days with a value.
    """
    known = sorted((day.toordinal(), v) for day, v in values.items() if math.isfinite(v))
    if len(known) < _FEWEST_DAYS:
        return None
    days, series = np.array(known[-_MOST_DAYS:]).T
    slope = theil_sen_slope(days, series)
    span_days = days[-1] - days[0]
    # The scatter of the days about the trend line.
    residuals = series - slope * days
    scatter = float(np.median(np.abs(residuals - np.median(residuals))))
    change = slope * span_days
    return (change, int(span_days)) if abs(change) > _ABOVE_SCATTER * scatter else None


def _shared_warmth(servos: Mapping[str, Sequence[ServoDay]]) -> dict[date, float]:
    """Return the median temperature of all servos by day, degC: the room's share."""
    by_day: dict[date, list[float]] = {}
    for days in servos.values():
        for day in days:
            if day.n_readings >= _FEWEST_READINGS and math.isfinite(day.temperature_degc):
                by_day.setdefault(day.day, []).append(day.temperature_degc)
    return {day: float(np.median(temperatures)) for day, temperatures in by_day.items()}


def _ago(days: int) -> str:
    return "a week ago" if days == 7 else f"{days} days ago"
