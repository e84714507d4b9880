"""`lipservo bench shapes`: Rhubarb's rules beside our lips, on a sound whose phones are known."""

from pathlib import Path
from typing import Annotated

import typer

from lipservo.commands.options import DEFAULT_FACE, Json, Model
from lipservo.terminal.output import RESULTS, machine_class, print_json


def shapes(
    sound: Annotated[Path, typer.Argument(help="Sound file.")],
    phonemes: Annotated[Path, typer.Argument(help="TextGrid with its true phones.")],
    picture: Annotated[
        Path | None, typer.Option(help="Draw 3 s of it as PNG.", show_default=False)
    ] = None,
    model: Model = None,
    as_json: Json = False,
) -> None:
    """Measure when the mouth closes for P, B and M: drawn by Rhubarb's rules, and ours."""
    from lipservo.commands.run.exported_speech import spoken_sound
    from lipservo.street.motion_options import ChosenMotion
    from lipservo.terminal.pictures import check_picture
    from lipservo_lab.bench.shapes.shape_figures import closing_figures, compared_shapes

    if picture is not None:
        check_picture(picture, [sound, phonemes])
    told, heard = (
        spoken_sound(sound, script, ChosenMotion(), DEFAULT_FACE, model)
        for script in (phonemes, None)
    )
    compared = compared_shapes(told, heard)
    rows = {name: closing_figures(compared.phones, each) for name, each in compared.closed.items()}
    if picture is not None:
        from lipservo_lab.bench.shapes.shape_plot import draw_shapes

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
