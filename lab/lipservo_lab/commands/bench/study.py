"""`lipservo bench study`: whether the figures of a study hold the truth, by simulated studies."""

import time
from typing import Annotated

import typer
from rich.progress import Progress

from lipservo.commands.options import Json, Quiet
from lipservo.terminal.output import MESSAGES, RESULTS, machine_class, print_json


def study(
    studies: Annotated[int, typer.Option(min=1, max=100_000, help="How many.")] = 200,
    honest: Annotated[int, typer.Option(min=2, max=1000, help="Raters who do as asked.")] = 16,
    lazy: Annotated[
        int, typer.Option(min=0, max=1000, help="Who do not, of each of three kinds.")
    ] = 1,
    inverted: Annotated[
        int, typer.Option(min=0, max=1000, help="Who read the scale backwards.")
    ] = 1,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Simulated raters of known taste sit studies, and each is counted as a real one would be.

    coverage: share of 95 % intervals that hold the truth, over ratings, pairs and words read.
    """
    from lipservo_lab.study.rehearsal import Crew, coverage_figures
    from lipservo_lab.study.sheets import Size

    began_s = time.perf_counter()
    with Progress(console=MESSAGES, transient=True, disable=quiet) as progress:
        found = coverage_figures(
            studies,
            Crew(honest, lazy, lazy, lazy, inverted),
            Size(),
            lambda n: progress.track(range(n), description="studies"),
        )
    seconds = round(time.perf_counter() - began_s, 1)
    if as_json:
        print_json({**found, "machine": machine_class(), "seconds": seconds})
        return
    for name, value in found.items():
        RESULTS.print(f"{name}: {value}")
    RESULTS.print(f"{machine_class()}; {seconds:.0f} s")
