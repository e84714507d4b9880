"""`lipservo bench sync`: whether lips and sound meet, at the encoders.

`lipservo bench face`: the page, and what head, eyes and lids do.

`lipservo bench line`: whether a late answer is ever taken for that to another question.

`lipservo bench scans`: registration of scans whose truth is known.

`lipservo bench shapes`: Rhubarb's rules beside our lips, on a sound whose phones are known.
"""

import time
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer

from lipservo.commands.options import DEFAULT_FACE, Json, Model, Quiet
from lipservo.commands.run.dashboard import check_dashboard
from lipservo.terminal.output import print_json, progress_bar
from lipservo_lab.commands.bench.printing import print_figures, print_table, with_machine
from lipsync.errors import UserError, check_extra


def face(
    sounds: Annotated[
        list[Path] | None,
        typer.Argument(help="Sound files of speech that move the head; default: the bundled clip."),
    ] = None,
    seconds: Annotated[
        float, typer.Option(min=1.0, help="Seconds that each measurement takes.")
    ] = 20.0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure the cost of the dashboard's streams, and the motion of head, eyes and lids.

    The motion is compared with published ranges. If Chromium is installed, the command also
    measures how soon the web page in Chromium shows the face.
    """
    check_dashboard()
    from lipservo_lab.bench.face.face_figures import face_figures

    with progress_bar(quiet=quiet) as advance:
        figures = face_figures(sounds or [], seconds, advance)
    print_figures(figures, as_json=as_json)


def line(
    questions: Annotated[
        int, typer.Option(min=1, help="Number of register reads over each disturbed line.")
    ] = 18_000,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Count wrong register values over serial lines that delay, echo, lose and add bytes.

    Four simulated servos answer in virtual time. Exit status 1 if a value was wrong.
    """
    from lipservo_lab.campaigns.line_campaign import line_figures

    began_s = time.perf_counter()
    with progress_bar(quiet=quiet) as advance:
        figures = line_figures(questions, partial(advance, "disturbances"))
    print_figures(figures, as_json=as_json, began_s=began_s)
    if any(counts["wrong_values"] for counts in figures.values()):
        raise typer.Exit(1)


def scans(
    n_scans: Annotated[
        int, typer.Option("--scans", min=2, help="Number of scans of each kind.")
    ] = 12,
    seed: Annotated[int, typer.Option(help="Random seed of faces, samples and noise.")] = 0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure how exactly `learn import-scans` finds a face's points, on scans with known points.

    The scans are made from the mean face. Errors are distances in mm from each point found to the
    true place of the same point of the skin, so sliding along the surface counts.
    """
    check_extra("trimesh", "bench scans")
    from lipservo_lab.bench.scan_figures import scan_figures
    from lipsync.face.model import load_face

    with progress_bar(quiet=quiet) as advance:
        figures: dict[str, Any] = scan_figures(load_face(), n_scans, seed, advance)
    if as_json:
        print_json(with_machine(figures))
    else:
        print_table([{"scans": name, **row} for name, row in figures["cases"].items()])


def shapes(
    sound: Annotated[Path, typer.Argument(help="Sound file.")],
    phonemes: Annotated[Path, typer.Argument(help="The sound's label file (docs/text.md).")],
    picture: Annotated[
        Path | None, typer.Option(help="Draw 3 s of the sound into this PNG file.")
    ] = None,
    model: Model = None,
    as_json: Json = False,
) -> None:
    """Compare when the mouth closes for P, B and M: by Rhubarb's rules, and by our motion."""
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
        print_json(with_machine({"methods": rows}))
    else:
        print_table([{"method": name, **row} for name, row in rows.items()])


def sync(
    quick: Annotated[
        bool, typer.Option("--quick", help="3 sentences, not 12; clock drift for 1 minute, not 10.")
    ] = False,
    face: Annotated[
        str | None,
        typer.Option(
            "--face",
            help="Instead: name of a face; count the closures of the bundled clip that its servos "
            "reach, and that Dynamixels in their place reach.",
        ),
    ] = None,
    timings: Annotated[
        bool,
        typer.Option(
            "--timings",
            help="Instead: measure which visemes the bundled clip shows if its phonemes come with "
            "wrong times.",
        ),
    ] = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure how well lips and sound agree in time, at simulated servos, on a virtual clock.

    The true phones and their times are the speech synthesiser's. With --face they are our
    recogniser's, for both kinds of servos.
    """
    from lipservo_lab.bench.sync.closures_at_shaft import closures_at_shaft
    from lipservo_lab.bench.sync.sync_figures import sync_figures
    from lipservo_lab.bench.sync.timed_units import timed_figures

    figures: dict[str, object]
    if quick + timings + (face is not None) > 1:
        raise UserError("give one of --quick, --face and --timings")
    if timings:
        with progress_bar(quiet=quiet) as advance:
            figures = {"timed": timed_figures(partial(advance, "defects"))}
    elif face is not None:
        figures = dict(closures_at_shaft(face))
    else:
        with progress_bar(quiet=quiet) as advance:
            figures = sync_figures(advance, quick=quick)
    print_figures(figures, as_json=as_json)
