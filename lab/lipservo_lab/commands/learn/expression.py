"""`train-expression`: head, gaze and lids are learned from somebody's tracks."""

from pathlib import Path
from typing import Annotated, cast

import typer

from lipservo.commands.options import Json, Quiet
from lipservo.terminal.output import RESULTS, print_json
from lipservo.terminal.progress_bar import progress_bar
from lipsync.output_file import check_output


def train_expression(
    corpus: Annotated[
        Path, typer.Argument(help="Folder like grid_s1, or of NAME.csv beside NAME.wav.")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="The file (.npz) to write.")],
    seed: Annotated[int, typer.Option(min=0, help="The same seed gives the same model.")] = 0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Learn how a head, its eyes and its lids go with a voice; measure it on what is held out.

    docs/expression-voice.md, "Learned from tracks", says what CORPUS holds.
    """
    from lipservo_lab.learning.expression.expression_training import train_expression as train
    from lipservo_lab.learning.learned_expression.expression_model import (
        is_expression,
        save_expression,
    )

    check_output(output, replaces=is_expression, kind="learned expression")
    with progress_bar(quiet=quiet) as advance:
        model, figures = train(corpus, seed, advance)
    save_expression(model, output)
    if as_json:
        print_json({"model": str(output), **figures})
        return
    RESULTS.print(
        f"{output}: learned from {figures['recordings']} recordings, {figures['minutes']} minutes",
        soft_wrap=True,
    )
    if figures["held_out"] is None:
        RESULTS.print("fewer than four recordings held out: nothing measured", soft_wrap=True)
        return
    for name, value in cast("dict[str, object]", figures["held_out"]).items():
        RESULTS.print(f"{name:>26}  {value}")
