"""`lipservo bench line`: whether a late answer is ever taken for that to another question."""

import time
from typing import Annotated

import typer
from rich.progress import Progress

from lipservo.commands.options import Json, Quiet
from lipservo.terminal.output import MESSAGES, RESULTS, machine_class, print_json


def line(
    questions: Annotated[
        int, typer.Option(min=1, help="How many are asked over each disturbed line.")
    ] = 18_000,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Count wrong register values over lines that delay, echo, lose and invent bytes.

    Four simulated servos in virtual time. Exit status 1 when a value was wrong.
    """
    from lipservo_lab.campaigns.line_campaign import line_figures

    began_s = time.perf_counter()
    with Progress(console=MESSAGES, transient=True, disable=quiet) as progress:
        steps = progress.add_task("disturbances", total=None)

        def advance(n_done: int, n_all: int) -> None:
            progress.update(steps, completed=n_done, total=n_all)

        figures = line_figures(questions, advance)
    machine, seconds = machine_class(), time.perf_counter() - began_s
    if as_json:
        print_json({**figures, "machine": machine, "seconds": seconds})
    else:
        for name, counts in figures.items():
            told = ", ".join(f"{what.replace('_', ' ')} {n}" for what, n in counts.items())
            RESULTS.print(f"{name}: {told}", highlight=False)
        RESULTS.print(f"machine: {machine}\nseconds: {seconds:.4g}", highlight=False)
    if any(counts["wrong_values"] for counts in figures.values()):
        raise typer.Exit(1)
