"""`train-offline`: the model that scripted lines are rendered with."""

import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.progress import Progress

from lipservo.commands.options import Json, Model, Quiet, SkipBad
from lipservo.terminal.output import MESSAGES, RESULTS, print_json

if TYPE_CHECKING:
    from lipservo_lab.corpus.utterance import Utterance


def train_offline(
    corpus: Annotated[
        Path, typer.Argument(help="Folder of recordings: sounds, landmarks, labels.")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="The model file to write.")],
    model: Model = None,
    states: Annotated[
        int | None, typer.Option(min=2, help="How many states; default: 100.", show_default=False)
    ] = None,
    components: Annotated[
        int | None,
        typer.Option(
            min=1, help="Principal components of the states; default: 10.", show_default=False
        ),
    ] = None,
    markers: Annotated[
        str | None,
        typer.Option(
            help="A layout of more points than the face's, for dense scans (corpus/layout.json); "
            "default: the face's own.",
            show_default=False,
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="The same seed gives the same model.")] = 0,
    skip_bad: SkipBad = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Learn what `render` needs beside a face model: states and units, and what sound tells.

    CORPUS is a folder as `lipservo learn face` takes it; give the face model that was made of it.
    """
    from lipservo_lab.corpus.grid import read_grid
    from lipservo_lab.learning.offline.offline_training import train_offline as train_model
    from lipservo_lab.learning.offline.state_training import Recipe
    from lipsync.face.model import load_face
    from lipsync.markers import find_layout
    from lipsync.offline.offline_model_file import is_offline_model, save_offline_model
    from lipsync.output_file import check_output

    face = load_face(model)
    standard = Recipe()
    recipe = Recipe(
        n_components=components or standard.n_components,
        n_states=states or standard.n_states,
        seed=seed,
    )
    check_output(output, replaces=is_offline_model, kind="offline model", inputs=[model])
    began_s = time.perf_counter()
    with Progress(console=MESSAGES, transient=True, disable=quiet) as progress:
        reading = progress.add_task("reading", total=None)

        def read(names: list[str]) -> Iterable[str]:
            yield from progress.track(names, task_id=reading)

        def listening(utterances: "Sequence[Utterance]") -> "Iterable[Utterance]":
            yield from progress.track(utterances, description="listening")

        sentences = read_grid(
            corpus,
            face.layout if markers is None else find_layout(markers),
            head_reference_mm=face.head_reference_mm,
            skip_bad=skip_bad,
            progress=read,
        )
        learning = progress.add_task("learning", total=None)
        made = train_model(
            sentences,
            face,
            recipe,
            progress=lambda step: progress.update(learning, description=step),
            listening=listening,
        )
    save_offline_model(made, output)
    seconds = time.perf_counter() - began_s
    for line in sentences.skipped:
        MESSAGES.print(f"left out: {line}", soft_wrap=True)
    figures: dict[str, object] = {
        "model": str(output),
        "face": made.face_checksum,
        "sentences": len(made.training_sentences),
        "skipped": len(sentences.skipped),
        "seconds": round(seconds, 1),
        "bytes": output.stat().st_size,
        **made.provenance,
    }
    if as_json:
        print_json(figures)
        return
    RESULTS.print(
        f"{output}: {figures['states']} states and {figures['units']} units of "
        f"{figures['sentences']} sentences, {output.stat().st_size / 1e6:.1f} MB, in "
        f"{seconds:.0f} s",
        soft_wrap=True,
    )
