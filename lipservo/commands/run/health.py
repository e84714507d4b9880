"""`health`: prints what was logged of each servo while it ran, and what is getting worse."""

import math
import os
from collections.abc import Sequence
from dataclasses import asdict
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from firmware_bridge.bus import describe_errors
from lipservo.commands.options import Json
from lipservo.health.health_history import History, ServoDay, errors_of, findings, read_history
from lipservo.health.health_log import MOST_DAYS, folder_name, logged_faces, places_searched
from lipservo.terminal.output import MESSAGES, RESULTS, print_json
from lipsync.errors import UserError


class HealthError(UserError):
    """The error for a health log that does not exist or cannot be read."""


def health(
    face: Annotated[
        str | None, typer.Option(help="Name of the face, as in its YAML; default: all faces.")
    ] = None,
    days: Annotated[
        int, typer.Option(min=1, help="Read the log of this many days on which the face ran.")
    ] = MOST_DAYS,
    as_json: Json = False,
) -> None:
    """Show what was logged of each servo while its face ran, and what is getting worse.

    Servos at a port are logged every ten seconds; servos simulated in memory are not.
    """
    logged = logged_faces(os.environ)
    if face is not None:
        wanted = folder_name(face)
        if wanted not in logged:
            known = ", ".join(logged) or "none"
            raise HealthError(
                f"nothing was logged of face {face!r} in {places_searched(os.environ)}; "
                f"known here: {known}"
            )
        logged = {wanted: logged[wanted]}
    try:
        histories = {name: read_history(folders, days) for name, folders in logged.items()}
    except OSError as error:
        raise HealthError(f"{error.filename}: cannot be read: {error.strerror}") from error
    if as_json:
        print_json({"faces": [_as_dict(name, history) for name, history in histories.items()]})
        return
    if not any(history.n_readings for history in histories.values()):
        RESULTS.print(
            f"nothing logged yet in {places_searched(os.environ)}: servos at a port are, every ten "
            "seconds while they run",
        )
    for name, history in histories.items():
        _print_history(name, history)


def _print_history(name: str, history: History) -> None:
    """Print a table of a face's servos, and findings on what is getting worse.

    name: of the face. Files and lines that cannot be read are printed first.
    """
    for line in history.bad_files:
        MESSAGES.print(line)
    if history.n_bad_lines:
        MESSAGES.print(f"{name}: {history.n_bad_lines} unreadable lines of the log were left out")
    if not history.n_readings:
        return
    dates = [day.day for days in history.servos.values() for day in days]
    n_days = len(set(dates))
    span = f"{max(dates)}" if n_days == 1 else f"{min(dates)} to {max(dates)}, {n_days} days"
    table = Table(
        title=f"{escape(name)}, {span}, {history.n_readings} readings",
        title_justify="left",
        box=None,
    )
    table.add_column("servo", no_wrap=True)
    for header in ("°C now", "max", "load", "mA", "V min", "errors", "reboots", "unanswered"):
        table.add_column(header, justify="left" if header == "errors" else "right")
    for servo, days in history.servos.items():
        table.add_row(servo, *_servo_cells(days))
    RESULTS.print(table)
    lines = findings(history.servos)
    grid = Table.grid(padding=(0, 1))
    for line in lines or ["nothing is getting worse"]:
        grid.add_row("-", escape(line))
    RESULTS.print(grid)
    RESULTS.print()


def _servo_cells(days: Sequence[ServoDay]) -> list[str]:
    """Return a servo's table cells: newest figures, and extremes, errors and counts of all days."""
    return [
        _cell(_last_known([day.latest_degc for day in days]), "{:.0f}"),
        _cell(max(_without_nan([day.hottest_degc for day in days]), default=math.nan), "{:.0f}"),
        _cell(_last_known([day.load for day in days]), "{:.0%}"),
        _cell(_last_known([day.current_ma for day in days]), "{:.0f}"),
        _cell(min(_without_nan([day.least_v for day in days]), default=math.nan), "{:.1f}"),
        describe_errors(errors_of(days)),
        str(sum(day.n_reboots for day in days)),
        str(sum(day.n_unanswered for day in days)),
    ]


def _without_nan(values: list[float]) -> list[float]:
    return [value for value in values if not math.isnan(value)]


def _last_known(values: list[float]) -> float:
    return next(reversed(_without_nan(values)), math.nan)


def _cell(value: float, form: str) -> str:
    return "-" if math.isnan(value) else form.format(value)


def _as_dict(name: str, history: History) -> dict[str, object]:
    """Return a face's history and findings as JSON values; the figures of servos are by day."""
    return {
        "face": name,
        "n_readings": history.n_readings,
        "n_bad_lines": history.n_bad_lines,
        "bad_files": list(history.bad_files),
        "servos": {servo: [_plain(day) for day in days] for servo, days in history.servos.items()},
        "findings": findings(history.servos),
    }


def _plain(day: ServoDay) -> dict[str, object]:
    """Return a servo's day as JSON values: its date as ISO text, and NaN as None."""
    content = {**asdict(day), "day": day.day.isoformat()}
    return {
        key: None if isinstance(value, float) and math.isnan(value) else value
        for key, value in content.items()
    }
