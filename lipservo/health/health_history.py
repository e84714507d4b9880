"""Reads health logs: what each servo was like, day by day."""

import json
import math
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path

import numpy as np

from lipservo.health.health_log import DAY_FILE
from lipsync.arrays import Array

_QUANTITIES = ("temperature_degc", "load", "voltage_v", "current_ma", "errors", "torque_on")
_COUNTS = ("reboots", "unanswered")


@dataclass(frozen=True, slots=True)
class ServoDay:
    """One servo on one UTC day. NaN: never heard, or not measured by its model.

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
    """Every servo of a face, its days in order. n_bad_lines: lines that could not be read."""

    servos: Mapping[str, Sequence[ServoDay]]
    n_readings: int
    n_bad_lines: int
    bad_files: tuple[str, ...]


@dataclass(slots=True)
class _Column:
    """What one servo said in the course of a day, reading by reading."""

    values: dict[str, list[float]] = field(
        default_factory=lambda: {name: [] for name in _QUANTITIES}
    )
    counts: Counter[str] = field(default_factory=Counter)


class _Counted:
    """Counts since a run began, made into counts since the reading before."""

    def __init__(self) -> None:
        self._number: float = -1.0
        self._last: dict[tuple[str, str], float] = {}
        self._began = False

    def news(
        self, record: Mapping[str, list[float]], names: list[str], number: float
    ) -> Counter[tuple[str, str]]:
        """By servo and quantity. A log that begins in the middle of a run tells nothing new."""
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
    """The newest `days` days on which anything was logged, and their files.

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
    """The newest `days` days of the logs in these folders; what cannot be read is counted.

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
    """How many lines could be read, and how many not."""
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
    """Names, the reading's number in its run, columns. Raises ValueError, TypeError, KeyError."""
    raw = json.loads(line)
    names = raw["servos"]
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise ValueError("no servo names")
    columns = {key: [_float(value) for value in raw[key]] for key in (*_QUANTITIES, *_COUNTS)}
    if any(len(column) != len(names) for column in columns.values()):
        raise ValueError("columns of different lengths")
    if not all(math.isfinite(value) for key in (*_COUNTS, "errors") for value in columns[key]):
        raise ValueError("a count that is no number")
    if not all(0 <= bits <= 255 for bits in columns["errors"]):
        raise ValueError("errors are a byte")
    return names, _float(raw["number"]), columns


def _float(value: object) -> float:
    if value is None:
        return math.nan
    if not isinstance(value, int | float):
        raise TypeError(f"{value!r} is no number")
    return float(value)


def _summarize(day: date, column: _Column) -> ServoDay:
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
        latest_degc=next(_backwards(warm), math.nan),
        load=_of(np.median, values["load"][on]),
        current_ma=_of(np.median, values["current_ma"][on]),
        least_v=_of(np.min, values["voltage_v"]),
        errors=errors,
        n_reboots=column.counts["reboots"],
        n_unanswered=column.counts["unanswered"],
    )


def _of(function: Callable[[Array], np.float64], values: Array) -> float:
    """NaN where nothing was heard."""
    heard = values[np.isfinite(values)]
    return float(function(heard)) if len(heard) else math.nan


def _backwards(values: Array) -> Iterator[float]:
    return (float(value) for value in values[::-1] if math.isfinite(value))
