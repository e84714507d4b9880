"""`lipservo bench study`: whether the figures of a study hold the truth, by simulated studies."""

import time
from functools import partial
from typing import Annotated

import typer

from lipservo.commands.options import Json, Quiet
from lipservo.terminal.output import progress_bar
from lipservo_lab.commands.bench.printing import print_figures
from lipservo_lab.commands.options import Inverted, Lazy


def study(
    studies: Annotated[int, typer.Option(min=1, max=100_000, help="Studies to simulate.")] = 200,
    honest: Annotated[int, typer.Option(min=2, max=1000, help="Number of careful raters.")] = 16,
    lazy: Lazy = 1,
    inverted: Inverted = 1,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Simulate studies with raters of known preferences, evaluated like a study with people.

    The result `coverage` is the share of 95 % intervals that contain the true value, over ratings,
    pairs and words read.
    """
    from lipservo_lab.study.rehearsal import Crew, coverage_figures
    from lipservo_lab.study.sheets import Size

    began_s = time.perf_counter()
    with progress_bar(quiet=quiet) as advance:
        found = coverage_figures(
            studies, Crew(honest, lazy, lazy, lazy, inverted), Size(), partial(advance, "studies")
        )
    print_figures(found, as_json=as_json, began_s=began_s)
