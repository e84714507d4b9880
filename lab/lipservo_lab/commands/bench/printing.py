"""How a bench prints: figures a line each, rows as tables, or all of it as one line of JSON."""

import time
from collections.abc import Mapping, Sequence

from rich.table import Table

from lipservo.terminal.output import RESULTS, machine_class, print_json


def print_figures(
    figures: Mapping[str, object], *, as_json: bool, began_s: float | None = None
) -> None:
    """Print figures and the machine that they are of.

    began_s: of `time.perf_counter`, when the bench began; None: its duration is not printed.
    """
    result = with_machine(figures, began_s)
    if as_json:
        print_json(result)
    else:
        print_lines(result)


def with_machine(figures: Mapping[str, object], began_s: float | None = None) -> dict[str, object]:
    """Return the figures with `machine` and, since `began_s`, `seconds`."""
    duration = {} if began_s is None else {"seconds": round(time.perf_counter() - began_s, 1)}
    return {**figures, "machine": machine_class(), **duration}


def print_lines(figures: Mapping[str, object]) -> None:
    """Print figures, a line each."""
    for name, value in figures.items():
        shown = f"{value:.4g}" if isinstance(value, float) else value
        RESULTS.print(f"{name}: {shown}", soft_wrap=True, highlight=False)


def print_table(
    rows: Sequence[Mapping[str, object]],
    headings: Mapping[str, str] | None = None,
    *,
    title: str | None = None,
) -> None:
    """Print rows as a table; nothing where there are none.

    headings: a column for each name that has one; None: for every name but those of intervals.
    """
    if not rows:
        return
    headings = headings or {name: name for name in rows[0] if not name.endswith("_95")}
    table = Table(
        *headings.values(), title=title, title_justify="left", box=None, pad_edge=False,
        padding=(0, 1, 0, 0),
    )  # fmt: skip
    for row in rows:
        table.add_row(*(cell(row[name]) for name in headings))
    RESULTS.print(table, "")


def cell(value: object) -> str:
    """Return a value as it stands in a table: three decimals, an interval two."""
    if isinstance(value, list):
        return " ".join("-" if x is None else f"{x:.2f}" for x in value)
    if isinstance(value, float):
        return f"{value:.3f}"
    return "" if value is None else str(value)
