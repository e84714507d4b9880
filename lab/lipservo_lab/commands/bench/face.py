"""`lipservo bench face`: the twin, the page, and what head, eyes and lids do."""

from pathlib import Path
from typing import Annotated

import typer

from lipservo.commands.options import Json, Quiet
from lipservo.commands.run.dashboard import check_dashboard
from lipservo.terminal.output import RESULTS, machine_class, print_json
from lipservo.terminal.progress_bar import progress_bar


def face(
    sounds: Annotated[
        list[Path] | None,
        typer.Argument(
            help="Speech that the head moves to; the bundled clip otherwise.", show_default=False
        ),
    ] = None,
    seconds: Annotated[
        float, typer.Option(min=1.0, help="How long each window of the streams is measured.")
    ] = 20.0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure the twin's mesh, the dashboard's streams, and expression against published ranges.

    A page that is shown is timed in a Chromium without a screen, where one is installed.
    """
    check_dashboard()
    from lipservo_lab.bench.face.face_figures import face_figures

    with progress_bar(quiet=quiet) as advance:
        figures = face_figures(sounds or [], seconds, advance)
    figures["machine"] = machine_class()
    if as_json:
        print_json(figures)
        return
    for name, value in figures.items():
        shown = f"{value:.4g}" if isinstance(value, float) else value
        RESULTS.print(f"{name}: {shown}", soft_wrap=True, highlight=False)
