"""`lipservo bench cost`: what a face's speech process costs at rest and speaking."""

import time
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from lipservo.commands.options import Json, Quiet
from lipservo.terminal.output import progress_bar
from lipservo_lab.commands.bench.printing import print_figures
from lipsync.errors import UserError


def cost(
    against: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Folder of another checkout to compare with; its servo goals must be equal.",
        ),
    ] = None,
    config: Annotated[str, typer.Option(help="Name of a shipped face.")] = "face_sim",
    listens: Annotated[
        bool, typer.Option("--listens", help="Let the face listen to a recording, not speak.")
    ] = False,
    cycles: Annotated[int, typer.Option(min=1, help="Number of cycles of speech and rest.")] = 5,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure the processor time of a face's speech process, speaking and at rest.

    The process runs on a virtual clock; a cycle has 3 s of speech and 8 s of rest. Exit status 1 if
    servo goals differ from those of --against by .005 degrees, or their times by a microsecond.
    """
    from lipservo_lab.bench.cost.cost_figures import cost_figures

    if against is not None and not (against / "lipservo" / "runtime").is_dir():
        raise UserError(f"--against {against}: holds no lipservo; give the folder of a checkout")
    began_s = time.perf_counter()
    with progress_bar(quiet=quiet) as advance:
        figures = cost_figures(
            None if against is None else against.resolve(),
            config,
            "file" if listens else "voice",
            cycles,
            partial(advance, "turns"),
        )
    print_figures(figures, as_json=as_json, began_s=began_s)
    if figures.get("goals_apart_deg", 0.0) >= 0.005 or figures.get("goals_apart_s", 0.0) >= 1e-6:
        raise typer.Exit(1)
