"""A report on a user's hardware, measured, for bug reports: `doctor --report`.

Only figures, and words out of fixed lists, leave the computer: no name, path, host, user or serial
number. Joints are `servo_1`, `servo_2` and so on, in the order of the face's YAML.
"""

import os
import platform
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from importlib.metadata import version
from itertools import pairwise
from typing import Any, Final, Literal, get_origin

import numpy as np
from pydantic import BaseModel

from firmware_bridge.bus import ServoBus
from firmware_bridge.bus_kinds import Finding, Severity
from firmware_bridge.clock import Clock, ticks
from firmware_bridge.errors import BusError
from firmware_bridge.pulse_bus import usb_product
from lipservo.settings.settings import FaceSettings
from lipsync.arrays import Array

FORMAT: Final = "lipservo hardware report"
FORMAT_VERSION: Final = 1
#: A step is so large where the joint has room, goes there and back so often, and waits so long.
STEP_DEG: Final = 5.0
N_STEPS: Final = 3
STEP_S: Final = 1.0
#: A shaft has settled within so much of its goal: half a degree, or a tenth of the step.
_SETTLED_DEG, _SETTLED_SHARE = 0.5, 0.1
#: An absolute path, or one of a home folder.
_PATH: Final = re.compile(r"(?:~|\.{1,2})?/[^\s,;:)\]}'\"]+")

Report = dict[str, Any]


def about_face(settings: FaceSettings) -> Report:
    """Return the report's part on versions, computer, buses and servos, without names."""
    return {
        "format": FORMAT,
        "version": FORMAT_VERSION,
        "lipservo": version("lipservo"),
        "computer": {
            "system": platform.system(),
            "machine": platform.machine(),
            "kernel": ".".join(re.findall(r"\d+", platform.release())[:2]),
            "python": platform.python_version(),
            "n_cpus": os.cpu_count(),
        },
        "buses": [
            {
                **plain_values(face.bus),
                "usb": usb_product(face.servo_port or ""),
                "capabilities": face.capabilities.as_dict(),
            }
            for face in settings.alone.values()
        ],
        "rate_hz": settings.rate_hz,
        "servos": [
            {"servo": label, **plain_values(servo)}
            for label, servo in zip(labels(settings), settings.servos.values(), strict=True)
        ],
    }


def labels(settings: FaceSettings) -> list[str]:
    """Return the joints' labels in a report: servo_1, servo_2, ..."""
    return [f"servo_{n}" for n in range(1, len(settings.servos) + 1)]


def plain_values(settings: BaseModel) -> dict[str, object]:
    """Return settings that are numbers, flags or words of a fixed list, and `model`, by name.

    model: of a servo; left out for settings of anything else.
    """
    values: dict[str, object] = {}
    for name, field in type(settings).model_fields.items():
        value = getattr(settings, name)
        is_listed = name == "kind" or get_origin(field.annotation) is Literal
        if isinstance(value, (bool, int, float)) or (is_listed and isinstance(value, str)):
            values[name] = value
    if model := getattr(settings, "make", None):
        values["model"] = model
    return values


def examined(
    settings: FaceSettings,
    secrets: Sequence[str],
    examine: Callable[[FaceSettings], Iterator[Finding]],
) -> list[dict[str, str]]:
    """Return the findings of `doctor`, scrubbed, with joints named servo_1, servo_2, ...

    secrets: texts to be removed. examine: yields findings; a BusError from it counts as one.
    """
    servos = dict(zip(labels(settings), settings.servos.values(), strict=True))
    scrubbed_findings = []
    try:
        for finding in examine(settings.model_copy(update={"servos": servos, "prevent": ()})):
            scrubbed_findings.append(_scrubbed_finding(finding, secrets))
    except BusError as error:
        scrubbed_findings.append(_scrubbed_finding(Finding(Severity.BAD, str(error)), secrets))
    return scrubbed_findings


def _scrubbed_finding(finding: Finding, secrets: Sequence[str]) -> dict[str, str]:
    return {
        "severity": finding.severity.name.lower(),
        "what": scrubbed(finding.what, secrets),
        "remedy": scrubbed(finding.remedy, secrets),
    }


def secrets_of(settings: FaceSettings, config: str) -> list[str]:
    """Return texts of this face and computer that no report may contain, the longest first.

    They are names and paths. config: the face's name or YAML path.
    """
    port = settings.servo_port or ""
    secrets = {port, os.path.realpath(port) if port else "", config, settings.name, platform.node()}
    secrets |= {os.environ.get(name, "") for name in ("USER", "LOGNAME", "HOME", "HOSTNAME")}
    secrets |= {
        *settings.servos,
        *settings.buses,
        *(bus.port or "" for bus in settings.buses.values()),
    }
    return sorted((secret for secret in secrets if len(secret) > 1), key=len, reverse=True)


def scrubbed(text: str, secrets: Sequence[str]) -> str:
    """Return the text without secrets, paths and long numbers, which may be those of a device."""
    for secret in secrets:
        text = re.sub(rf"(?<!\w){re.escape(secret)}(?!\w)", "[...]", text)
    return re.sub(r"\b[0-9A-Fa-f]{8,}\b", "[...]", _PATH.sub("[path]", text))


def limp_loop(bus: ServoBus, rate_hz: float, seconds: float, clock: Clock) -> Report:
    """Read and write limp servos for `seconds`; return durations (ms) and counts of errors.

    Goals are the servos' present positions: no servo moves. rate_hz: reads and writes a second.
    """
    goals_deg = bus.read().start_deg(bus.capabilities)
    has_place = bus.capabilities.place
    began_s = clock.now()
    durations: dict[str, list[float]] = {"read_ms": [], "write_ms": [], "look_after_ms": []}
    late_ms: list[float] = []
    n_late = 0
    unanswered = np.zeros(len(goals_deg), dtype=np.int64)
    for time_s, n_missed in ticks(clock, rate_hz):
        if time_s - began_s >= seconds:
            break
        times_s = [clock.now()]
        late_ms.append(1e3 * (times_s[0] - time_s))
        n_late += n_missed
        bus.write_positions(goals_deg)
        times_s.append(clock.now())
        feedback = bus.feedback()
        times_s.append(clock.now())
        bus.look_after()
        times_s.append(clock.now())
        for name, spent_s in zip(
            ("write_ms", "read_ms", "look_after_ms"), np.diff(times_s), strict=True
        ):
            durations[name].append(1e3 * float(spent_s))
        unanswered += feedback.age_s > 0.0
    if not has_place:
        del durations["read_ms"]  # nothing comes back
    return {
        "seconds": round(clock.now() - began_s, 2),
        "n_ticks": len(late_ms),
        "n_late": n_late,
        "late_ms": spread(late_ms),
        **{name: spread(values) for name, values in durations.items()},
        "unanswered": unanswered.tolist() if has_place else None,
        "remarks": len(bus.remarks()),
    }


def spread(values: Sequence[float]) -> dict[str, float] | None:
    """Return median (p50), 99th percentile (p99) and worst of values; None without values."""
    if not values:
        return None
    percentiles = np.percentile(values, [50.0, 99.0, 100.0])
    return dict(zip(("p50", "p99", "worst"), percentiles.round(3).tolist(), strict=True))


def step_goals(min_deg: float, max_deg: float, rate_hz: float) -> Array:
    """Return goals of a joint: 3 steps of 5 deg, or up to its limit, from 0 and back, 1 s each.

    Parameters
    ----------
    min_deg,max_deg : float
        The joint's limits.
    rate_hz : float
        Goals a second.

    Returns
    -------
    Array
        (n, 1) degrees.
    """
    size_deg = min(STEP_DEG, max_deg) if max_deg >= -min_deg else max(-STEP_DEG, min_deg)
    n_held = round(STEP_S * rate_hz)
    there_and_back = np.repeat([size_deg, 0.0], n_held)
    return np.concatenate([np.zeros(n_held), np.tile(there_and_back, N_STEPS)])[:, np.newaxis]


def step_answers(
    goals_deg: Array, seen_deg: Array, rate_hz: float
) -> list[dict[str, float | None]]:
    """Return how a shaft answered each step.

    late_ms: until it has gone a tenth of the step; settled_ms: until it stays near its goal (0.5
    deg or a tenth of the step, if more), None: it does not; beyond_deg: how far past it; off_deg:
    its final position minus the goal.

    Parameters
    ----------
    goals_deg,seen_deg : Array
        (n,) degrees, one a tick: goals sent, positions read.
    rate_hz : float
        Ticks a second.

    Returns
    -------
    list[dict[str, float | None]]
        One mapping a step.
    """
    step_begins = [0, *(np.flatnonzero(np.diff(goals_deg)) + 1).tolist(), len(goals_deg)]
    answers: list[dict[str, float | None]] = []
    for first, end in pairwise(step_begins[1:]):
        goal_deg, start_deg = goals_deg[first], goals_deg[first - 1]
        step_deg = goal_deg - start_deg
        share_gone = (seen_deg[first:end] - start_deg) / step_deg
        near_deg = max(_SETTLED_DEG, _SETTLED_SHARE * abs(step_deg))
        is_far = np.abs(seen_deg[first:end] - goal_deg) > near_deg
        # Ticks up to the last one outside the tolerance.
        unsettled = int(np.flatnonzero(is_far)[-1]) + 1 if is_far.any() else 0
        started = np.flatnonzero(share_gone >= _SETTLED_SHARE)
        # The last quarter of the step shows where the shaft came to rest.
        end_deg = float(np.median(seen_deg[end - (end - first) // 4 - 1 : end]))
        answers.append(
            {
                "step_deg": round(float(step_deg), 2),
                "late_ms": _delay_ms(started[0], rate_hz) if len(started) else None,
                "settled_ms": _delay_ms(unsettled, rate_hz) if unsettled < end - first else None,
                "beyond_deg": round(max(0.0, float(share_gone.max() - 1.0) * abs(step_deg)), 2),
                "off_deg": round(end_deg - float(goal_deg), 2),
            }
        )
    return answers


def _delay_ms(n_ticks: int, rate_hz: float) -> float:
    """Return the time in ms from a goal to the reading n_ticks later."""
    # Encoders are read half a tick after a goal was sent.
    return round(1e3 * (float(n_ticks) + 0.5) / rate_hz, 1)


def as_text(report: Mapping[str, Any]) -> str:
    """Return a report as text: one line for each figure, sections by their names."""
    findings = [
        f"{each['severity']}: {each['what']}" + (f" -> {each['remedy']}" if each["remedy"] else "")
        for each in report["findings"]
    ]
    return "".join(f"{line}\n" for line in _yaml_lines({**report, "findings": findings}, 0))


def _yaml_lines(value: Mapping[str, Any], depth: int) -> Iterator[str]:
    """Yield a report's entries as lines of text in the form of YAML, indented `depth` levels."""
    indent = "  " * depth
    for name, each in value.items():
        if isinstance(each, Mapping):
            yield f"{indent}{name}:"
            yield from _yaml_lines(each, depth + 1)
        elif isinstance(each, list) and each and isinstance(each[0], Mapping):
            yield f"{indent}{name}:"
            for entry in each:
                pairs = ", ".join(f"{key} {_shown_value(one)}" for key, one in entry.items())
                yield f"{indent}  - {pairs}"
        elif isinstance(each, list) and each and isinstance(each[0], str):
            yield f"{indent}{name}:"
            yield from (f"{indent}  - {entry}" for entry in each)
        else:
            yield f"{indent}{name}: {_shown_value(each)}"


def _shown_value(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    if value is None:
        return "not known"
    return f"{value:g}" if isinstance(value, float) else str(value)
