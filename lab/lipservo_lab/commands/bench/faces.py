"""`lipservo bench sync`: whether lips and sound meet, at the encoders.

`lipservo bench face`: the twin, the page, and what head, eyes and lids do.

`lipservo bench line`: whether a late answer is ever taken for that to another question.

`lipservo bench scans`: registration of scans whose truth is known.

`lipservo bench shapes`: Rhubarb's rules beside our lips, on a sound whose phones are known.
"""

import time
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.progress import Progress

from lipservo.commands.options import DEFAULT_FACE, Json, Model, Quiet
from lipservo.commands.run.dashboard import check_dashboard
from lipservo.terminal.output import MESSAGES, RESULTS, machine_class, print_json, progress_bar
from lipsync.errors import UserError, check_extra


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
            counted = ", ".join(f"{what.replace('_', ' ')} {n}" for what, n in counts.items())
            RESULTS.print(f"{name}: {counted}", highlight=False)
        RESULTS.print(f"machine: {machine}\nseconds: {seconds:.4g}", highlight=False)
    if any(counts["wrong_values"] for counts in figures.values()):
        raise typer.Exit(1)


def scans(
    n_scans: Annotated[
        int, typer.Option("--scans", min=2, help="How many scans of each kind.")
    ] = 12,
    seed: Annotated[int, typer.Option(help="Other faces, samples and noise.")] = 0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure how near registered points come to where they are, on scans made of the mean face.

    The distance is that of the same point of the skin: sliding along the surface counts.
    """
    check_extra("trimesh", "bench scans")
    from lipservo_lab.bench.scan_figures import scan_figures
    from lipsync.face.model import load_face

    with progress_bar(quiet=quiet) as advance:
        figures: dict[str, Any] = scan_figures(load_face(), n_scans, seed, advance)
    figures["machine"] = machine_class()
    if as_json:
        print_json(figures)
        return
    for name, row in figures["cases"].items():
        RESULTS.print(
            f"{name}: {row['median_mm']} mm median, {row['p95_mm']} at 95 %; lips "
            f"{row['lips_median_mm']}, {row['lips_p95_mm']}; where speech moves the skin "
            f"{row['moved_median_mm']}, {row['moved_p95_mm']} (of "
            f"{row['unregistered_moved_median_mm']} mm); surface {row['surface_median_mm']}; "
            f"{row['seconds_per_scan']} s a scan",
            soft_wrap=True,
            highlight=False,
        )


def shapes(
    sound: Annotated[Path, typer.Argument(help="Sound file.")],
    phonemes: Annotated[Path, typer.Argument(help="File of its true phones.")],
    picture: Annotated[
        Path | None, typer.Option(help="Draw 3 s of it as PNG.", show_default=False)
    ] = None,
    model: Model = None,
    as_json: Json = False,
) -> None:
    """Measure when the mouth closes for P, B and M: drawn by Rhubarb's rules, and ours."""
    from lipservo.rendering.spoken_sound import spoken_sound
    from lipservo.runtime.motion_options import ChosenMotion
    from lipservo.terminal.pictures import check_picture
    from lipservo_lab.bench.shape_figures import closing_figures, compared_shapes
    from lipsync.phoneme_files.label_file import LabelFile

    if picture is not None:
        check_picture(picture, [sound, phonemes])
    from_text, heard = (
        spoken_sound(sound, script, ChosenMotion(), DEFAULT_FACE, model)
        for script in (LabelFile(phonemes), None)
    )
    compared = compared_shapes(from_text, heard)
    rows = {name: closing_figures(compared.phones, each) for name, each in compared.closed.items()}
    if picture is not None:
        from lipservo_lab.bench.shape_figures import draw_shapes

        draw_shapes(compared, sound, picture)
    if as_json:
        print_json({"methods": rows, "machine": machine_class()})
        return
    for name, row in rows.items():
        RESULTS.print(
            f"{name}: closed in {row['met']} of {row['phones']}, median {row['median_ms']} ms, "
            f"p10 {row['p10_ms']}, p90 {row['p90_ms']}",
            soft_wrap=True,
            highlight=False,
        )


def sync(
    quick: Annotated[
        bool, typer.Option("--quick", help="A quarter of the sentences, a minute of drift.")
    ] = False,
    face: Annotated[
        str | None,
        typer.Option(
            "--face",
            help="Instead: closures of the clip of `make run` at the shafts of this face's servos, "
            "over those of the same face on Dynamixels.",
            show_default=False,
        ),
    ] = None,
    timings: Annotated[
        bool,
        typer.Option(
            "--timings",
            help="Instead: the visemes shown of that clip beside wrong times of its phonemes.",
        ),
    ] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure lips against sound at the encoders of simulated servos, on a virtual clock.

    Phones and their times are the synthesiser's, never our recogniser's; with --face the
    recogniser, on either side.
    """
    from lipservo_lab.bench.sync.closures_at_shaft import closures_at_shaft
    from lipservo_lab.bench.sync.sync_figures import sync_figures
    from lipservo_lab.bench.sync.timed_units import timed_figures

    figures: dict[str, object]
    if quick + timings + (face is not None) > 1:
        raise UserError("--quick, --face, --timings: give one of them")
    if timings:
        with progress_bar(quiet=quiet) as advance:
            figures = {"timed": timed_figures(partial(advance, "defects"))}
    elif face is not None:
        figures = dict(closures_at_shaft(face))
    else:
        with progress_bar(quiet=quiet) as advance:
            figures = sync_figures(advance, quick=quick)
    figures["machine"] = machine_class()
    if as_json:
        print_json(figures)
        return
    for name, value in figures.items():
        RESULTS.print(f"{name}: {value}", soft_wrap=True, highlight=False)
