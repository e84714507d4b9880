"""`lines render-folder`: every sound of a folder becomes a performance."""

import os
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lipservo.commands.lines.render import (
    ExpressionOf,
    LineMethodName,
    LineStrength,
    Offline,
    ReferenceSound,
)
from lipservo.commands.options import Json, Model, Quiet
from lipservo.terminal.output import MESSAGES, RESULTS, print_json
from lipsync.errors import UserError

if TYPE_CHECKING:
    from lipservo.rendering.rendered import Rendering
    from lipservo_lab.rendering.cluster import Cluster


def render_folder(
    folder: Annotated[
        Path, typer.Argument(exists=True, file_okay=False, help="Folder of sound files.")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="Folder for the performances.")],
    method: LineMethodName = "heard",
    strength: LineStrength = 1.0,
    model: Model = None,
    offline: Offline = None,
    reference_sound: ReferenceSound = False,
    expression: ExpressionOf = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, help="Number of processes; default: one per core.")
    ] = None,
    dask: Annotated[
        str | None,
        typer.Option(
            metavar="HOST:PORT", help="Address of a Dask scheduler; its cluster then renders."
        ),
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Render every sound of a folder to a performance, on all cores or on a Dask cluster.

    The phonemes or words come from NAME.TextGrid, NAME.json or NAME.txt beside NAME.wav; without
    them the recogniser finds the phonemes. A performance that was already made of the same sound,
    with the same models and options, is not made again.
    """
    from lipservo.rendering.rendered import Rendering
    from lipservo.runtime.servos.assembly import load_settings
    from lipsync.errors import check_extra

    if method == "model-based":
        check_extra("dtaidistance", "lines render-folder --method model-based")
    if jobs is not None and dask is not None:
        raise UserError("give --jobs or --dask, not both")
    how = Rendering(method, strength, model, offline, not reference_sound, expression)
    if expression is not None:
        load_settings(expression)  # refused before anything is heard
    n_processes = jobs or os.cpu_count() or 1
    with ExitStack() as stack:
        cluster = None if dask is None else stack.enter_context(_cluster(dask))
        _render_folder(folder, output, how, n_processes, cluster, as_json=as_json, quiet=quiet)


def _cluster(address: str) -> "AbstractContextManager[Cluster]":
    from lipservo_lab.rendering.cluster import cluster_at
    from lipsync.errors import check_extra

    check_extra("distributed", "lines render-folder --dask")
    return cluster_at(address)


def _render_folder(
    folder: Path,
    output: Path,
    how: "Rendering",
    n_processes: int,
    cluster: "Cluster | None",
    *,
    as_json: bool,
    quiet: bool,
) -> None:
    """Render all sounds of a folder that are not yet rendered, and print what was done.

    how: options. cluster: None renders on `n_processes` of this computer. Raises UserError with all
    failures, after everything else was rendered and printed.
    """
    from rich.progress import Progress

    from lipservo.rendering.rendered import load_speaker
    from lipservo_lab.rendering.batch import lines_of, render_all, unrendered
    from lipsync.errors import check_extra
    from lipsync.offline.performance import is_performance
    from lipsync.output_file import OutputError, check_output

    check_extra("joblib", "rendering a folder")
    lines = lines_of(folder, output)
    load_speaker(how.model, how.offline)  # a wrong model is reported once, not for every line
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{output}: no folder can be made there ({error.strerror})") from error
    for line in lines:
        check_output(line.output, replaces=is_performance, kind="performance")
    missing = unrendered(lines, how)
    n_kept = len(lines) - len(missing)
    with Progress(console=MESSAGES, transient=True, disable=quiet) as progress:
        task = progress.add_task("rendering", total=len(lines), completed=n_kept)
        rendered, failed = render_all(
            missing, how, n_processes, lambda: progress.advance(task), cluster
        )
    for each in rendered:
        for note in each.notes:
            MESSAGES.print(f"{each.output}: {note}", soft_wrap=True)
    if as_json:
        print_json(
            {
                "output": str(output),
                "method": how.method,
                "rendered": len(rendered),
                "kept": n_kept,
                "failed": failed,
                "duration_s": sum(each.duration_s for each in rendered),
                "seconds": round(sum(each.seconds for each in rendered), 3),
            }
        )
    else:
        kept = f", {n_kept} were already" if n_kept else ""
        RESULTS.print(
            f"{output}: {len(rendered)} of {len(lines)} lines rendered{kept}", soft_wrap=True
        )
    if failed:
        raise UserError("\n".join(f"not rendered: {reason}" for reason in failed.values()))
