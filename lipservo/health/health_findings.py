"""What is getting worse with the servos of a face: sentences from the days of its log."""

import math
from collections.abc import Mapping, Sequence
from datetime import date
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from firmware_bridge.health import describe_errors
from lipservo.health.health_history import ServoDay

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


def findings(servos: Mapping[str, Sequence[ServoDay]]) -> list[str]:
    """One sentence each, with what to do; the urgent ones first."""
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
    """The median of the slopes of all pairs: Sen, J. Am. Stat. Assoc. 63 (1968) 1379."""
    slopes = [
        (values[j] - values[i]) / (times[j] - times[i])
        for i, j in combinations(range(len(times)), 2)
    ]
    return float(np.median(slopes))


def _troubles(name: str, days: Sequence[ServoDay]) -> list[str]:
    """What a servo itself complained of in the newest days, and silence."""
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
    silence = [_per_hour(day) for day in days if day.n_readings >= _FEWEST_READINGS]
    if len(silence) > 1:
        before = float(np.median(silence[:-1]))
        if silence[-1] >= max(_MANY_PER_HOUR, _TIMES_BEFORE * before):
            lines.append(
                f"{name} left {silence[-1]:.0f} questions an hour unanswered, {before:.0f} before: "
                "look at its plug and cable, and at those before it in the chain"
            )
    return lines


def _trends(name: str, days: Sequence[ServoDay], shared: Mapping[date, float]) -> list[str]:
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
    """How much it rose, and within how many days; None where that cannot be told from chance."""
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
    """The median over all servos, day by day: the room's share."""
    by_day: dict[date, list[float]] = {}
    for days in servos.values():
        for day in days:
            if day.n_readings >= _FEWEST_READINGS and math.isfinite(day.temperature_degc):
                by_day.setdefault(day.day, []).append(day.temperature_degc)
    return {day: float(np.median(list_)) for day, list_ in by_day.items()}


def _per_hour(day: ServoDay) -> float:
    return day.n_unanswered / (day.n_readings * _PERIOD_HOURS)


def _ago(days: int) -> str:
    return "a week ago" if days == 7 else f"{days} days ago"
