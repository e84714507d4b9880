"""`lipservo bench inputs`: odd files and texts of every kind, and what becomes of each."""

import time
from typing import Annotated, cast

import typer

from lipservo.commands.options import Json, Quiet
from lipservo.terminal.output import RESULTS, progress_bar
from lipservo_lab.commands.bench.printing import print_figures
from lipsync.errors import check_extra


def inputs(
    each: Annotated[int, typer.Option(min=1, help="Number of inputs of each kind.")] = 84,
    seed: Annotated[int, typer.Option(help="Random seed of the inputs.")] = 0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Feed odd labels, sounds, ranges, texts, markers, photographs and names to their readers.

    Each input is generated together with the right answer. Exit status 1 if an input made its
    reader raise a traceback or hang, or was read wrongly without a message.
    """
    for library in ("ezc3d", "PIL"):
        check_extra(library, "bench inputs")
    from lipservo_lab.bench.inputs.input_figures import input_figures

    began_s = time.perf_counter()
    with progress_bar(quiet=quiet) as advance:
        figures = input_figures(each, seed, advance)
    wrong = {} if as_json else cast("dict[str, list[object]]", figures.pop("wrong"))
    print_figures(figures, as_json=as_json, began_s=began_s)
    for kind, lines in wrong.items():
        for line in lines:
            RESULTS.print(f"{kind}: {line}", soft_wrap=True, highlight=False, markup=False)
    if any(figures[name] for name in ("tracebacks", "hangs", "silently_wrong")):
        raise typer.Exit(1)
