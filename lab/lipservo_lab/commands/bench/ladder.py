"""`lipservo bench ladder`: how a face hears while other programs take the computer."""

import tempfile
import time
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import Progress

from lipservo.commands.options import Json, Quiet
from lipservo.terminal.output import MESSAGES, RESULTS, machine_class, print_json


def ladder(
    minutes: Annotated[
        float, typer.Option(min=0.8, max=600.0, help="How long the face listens.")
    ] = 10.0,
    programs: Annotated[
        int, typer.Option(min=1, max=64, help="How many programs are busy for each core.")
    ] = 2,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure who listens while every core is busy for 1, 2 and 5 s of every minute.

    On a whole `lipservo run` in real time; and how soon loudness takes over from a recogniser that
    takes ten times as long as its sound.
    """
    from lipservo.street.daemon import stopped_by_signals
    from lipservo_lab.bench.hearing.ladder_figures import ladder_figures

    began_s = time.perf_counter()
    with (
        tempfile.TemporaryDirectory(prefix="ladder-") as folder,
        Progress(console=MESSAGES, transient=True, disable=quiet or as_json) as progress,
        stopped_by_signals() as stop,
    ):
        steps = progress.add_task("listening", total=None)

        def advance(done_s: float, whole_s: float) -> None:
            progress.update(steps, completed=done_s, total=whole_s)

        figures = ladder_figures(minutes, programs, Path(folder), advance, stop.is_set)
    result = {
        **figures,
        "minutes": minutes,
        "programs_per_core": programs,
        "machine": machine_class(),
        "seconds": time.perf_counter() - began_s,
    }
    if as_json:
        print_json(result)
        return
    for name, value in result.items():
        RESULTS.print(f"{name}: {value:.4g}" if isinstance(value, float) else f"{name}: {value}")
