"""`lipservo bench replay`: how much faster than sound a file is replayed."""

import tempfile
from importlib import resources
from pathlib import Path
from typing import Annotated

import typer

from lipservo.commands.options import Json
from lipservo.terminal.output import RESULTS, machine_class, print_json


def replay(
    sound: Annotated[
        Path | None,
        typer.Argument(help="Sound file; default: 20 s of the bundled clip.", show_default=False),
    ] = None,
    times: Annotated[int, typer.Option(min=1, help="The median of so many replays counts.")] = 5,
    as_json: Json = False,
) -> None:
    """Measure the speed of `replay`, and of its recogniser with sound ahead and without."""
    from lipservo_lab.bench.replay_figures import repeated, replay_figures

    if sound is not None:
        figures = replay_figures(sound, times)
    else:
        with (
            resources.as_file(resources.files("lipservo.clips") / "welcome.flac") as clip,
            tempfile.TemporaryDirectory() as folder,
        ):
            figures = replay_figures(repeated(clip, Path(folder) / "welcome.wav"), times)
    result = {**figures, "machine": machine_class()}
    if as_json:
        print_json(result)
        return
    for name, value in result.items():
        RESULTS.print(f"{name}: {value:.4g}" if isinstance(value, float) else f"{name}: {value}")
