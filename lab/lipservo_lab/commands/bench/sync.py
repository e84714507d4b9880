"""`lipservo bench sync`: whether lips and sound meet, at the encoders."""

from typing import Annotated

import typer

from lipservo.commands.options import Json, Quiet
from lipservo.terminal.output import RESULTS, machine_class, print_json
from lipservo.terminal.progress_bar import progress_bar


def sync(
    quick: Annotated[
        bool, typer.Option("--quick", help="A quarter of the sentences, a minute of drift.")
    ] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure lips against sound at the encoders of simulated servos, on a virtual clock.

    What is said when is told by the synthesiser, never by our recogniser.
    """
    from lipservo_lab.bench.sync.figures import sync_figures

    with progress_bar(quiet=quiet) as advance:
        figures = sync_figures(advance, quick=quick)
    figures["machine"] = machine_class()
    if as_json:
        print_json(figures)
        return
    for name, value in figures.items():
        RESULTS.print(f"{name}: {value}", soft_wrap=True, highlight=False)
