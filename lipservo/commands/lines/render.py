"""`render`: sounds become performances, one or a folder of them."""

import os
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from lipservo.commands.options import Json, Model, Quiet
from lipservo.settings.motion_names import STRONGEST
from lipservo.terminal.output import MESSAGES, RESULTS, print_json
from lipsync.errors import UserError

if TYPE_CHECKING:
    from distributed import Client

    from lipservo.rendering.rendered import Rendering

Method = Literal["heard", "model-based", "live"]


def render(
    audio: Annotated[Path, typer.Argument(help="Sound file, or folder of sound files.")],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="File to write (.perf), or folder for a folder.")
    ],
    text: Annotated[
        str | None,
        typer.Option(help="What is said, or a text file that holds it.", show_default=False),
    ] = None,
    textgrid: Annotated[
        Path | None,
        typer.Option(
            help="When which phone is said: a TextGrid, or another file of docs/speech.md.",
            show_default=False,
        ),
    ] = None,
    method: Annotated[
        Method,
        typer.Option(help="By phonemes and sound; as published; or as a face does live."),
    ] = "heard",
    strength: Annotated[
        float, typer.Option(min=0.0, max=STRONGEST, help="How far the mouth moves.")
    ] = 1.0,
    model: Model = None,
    offline: Annotated[
        Path | None,
        typer.Option(help="Offline model (.npz); default: the shipped one.", show_default=False),
    ] = None,
    reference_sound: Annotated[
        bool,
        typer.Option("--reference-sound", help="Name the sound in the file, do not include it."),
    ] = False,
    expression: Annotated[
        str | None,
        typer.Option(
            metavar="FACE",
            help="Store head, eyes, lids and brows too, as this face (name or YAML) moves them.",
            show_default=False,
        ),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(min=1, help="Processes for a folder; default: one a core."),
    ] = None,
    dask: Annotated[
        str | None,
        typer.Option(
            metavar="HOST:PORT",
            help="Render a folder on the Dask cluster of this scheduler.",
            show_default=False,
        ),
    ] = None,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Render lines to performances: the whole line is heard before the mouth moves.

    Of a folder, every sound: what is said tells NAME.TextGrid, NAME.json or NAME.txt beside it.
    Without any of them, and without --text and --textgrid, the recogniser listens.
    """
    from lipservo.rendering.rendered import Rendering, check_expression_of
    from lipsync.extras import check_extra

    if method == "model-based":
        check_extra("dtaidistance", "render --method model-based")
    if text is not None and textgrid is not None:
        raise UserError("--text and --textgrid: give one of them")
    if jobs is not None and dask is not None:
        raise UserError("--jobs and --dask: give one of them")
    how = Rendering(method, strength, model, offline, not reference_sound, expression)
    if expression is not None:
        check_expression_of(expression)
    if audio.is_dir():
        if text is not None or textgrid is not None:
            raise UserError(f"{audio}: is a folder; put texts and TextGrids beside its sounds")
        n_processes = jobs or os.cpu_count() or 1
        with ExitStack() as stack:
            cluster = None if dask is None else stack.enter_context(_cluster(dask))
            _render_folder(audio, output, how, n_processes, cluster, as_json=as_json, quiet=quiet)
        return
    if dask is not None:
        raise UserError(f"{audio}: is one sound; --dask renders a folder of them")
    _render_one(audio, text, textgrid, output, how, as_json=as_json)


def _cluster(address: str) -> "AbstractContextManager[Client]":
    from lipservo.rendering.cluster import cluster_at
    from lipsync.extras import check_extra

    check_extra("distributed", "render --dask")
    return cluster_at(address)


def _render_one(
    audio: Path,
    text: str | None,
    phones: Path | None,
    output: Path,
    how: "Rendering",
    *,
    as_json: bool,
) -> None:
    from lipservo.rendering.batch import given_text
    from lipservo.rendering.rendered import render as render_line
    from lipservo.rendering.spoken_line import Script
    from lipsync.offline.performance_file import is_performance
    from lipsync.output_file import check_output

    inputs = [audio, phones, how.model, how.offline]
    check_output(output, replaces=is_performance, kind="performance", inputs=inputs)
    done = render_line(audio, Script(phones, given_text(text)), output, how)
    for note in done.notes:
        MESSAGES.print(f"{audio}: {note}", soft_wrap=True)
    if as_json:
        print_json(
            {
                "output": str(output),
                "method": how.method,
                "duration_s": done.duration_s,
                "phonemes": done.n_phonemes,
                "seconds": round(done.seconds, 3),
                "notes": done.notes,
            }
        )
        return
    RESULTS.print(
        f"{output}: {done.duration_s:.1f} s, {done.n_phonemes} phonemes, {how.method}, rendered in "
        f"{done.seconds:.2f} s",
        soft_wrap=True,
    )


def _render_folder(
    folder: Path,
    output: Path,
    how: "Rendering",
    n_processes: int,
    cluster: "Client | None",
    *,
    as_json: bool,
    quiet: bool,
) -> None:
    from rich.progress import Progress

    from lipservo.rendering.batch import lines_of, render_all
    from lipservo.rendering.rendered import load_speaker
    from lipsync.extras import check_extra
    from lipsync.offline.performance_file import is_performance
    from lipsync.output_file import OutputError, check_output

    check_extra("joblib", "rendering a folder")
    lines = lines_of(folder, output)
    load_speaker(how.model, how.offline)  # a model that is wrong is told once, not for every line
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"{output}: no folder can be made there ({error.strerror})") from error
    for line in lines:
        check_output(line.output, replaces=is_performance, kind="performance")
    with Progress(console=MESSAGES, transient=True, disable=quiet) as progress:
        task = progress.add_task("rendering", total=len(lines))
        rendered, failed = render_all(
            lines, how, n_processes, lambda: progress.advance(task), cluster
        )
    for done in rendered:
        for note in done.notes:
            MESSAGES.print(f"{done.output}: {note}", soft_wrap=True)
    if as_json:
        print_json(
            {
                "output": str(output),
                "method": how.method,
                "rendered": len(rendered),
                "failed": failed,
                "duration_s": sum(done.duration_s for done in rendered),
                "seconds": round(sum(done.seconds for done in rendered), 3),
            }
        )
    else:
        RESULTS.print(f"{output}: {len(rendered)} of {len(lines)} lines rendered", soft_wrap=True)
    if failed:
        raise UserError("\n".join(f"not rendered: {reason}" for reason in failed.values()))
