"""`train`: a face model is learned from recordings."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.progress import Progress

from lipservo.commands.options import Json, Quiet, SkipBad
from lipservo.terminal.output import MESSAGES, RESULTS, print_json
from lipsync.output_file import check_output

#: What the expectation learns from.
Phonemes = Literal["both", "true"]


def train(
    corpus: Annotated[
        Path, typer.Argument(help="Folder of recordings: sounds, landmarks, labels.")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="The model file to write.")],
    seed: Annotated[int, typer.Option(help="The same seed gives the same model.")] = 0,
    animphos: Annotated[
        int | None,
        typer.Option(
            min=1, help="How many AnimPhos; default: so many that each has 3.45 successors."
        ),
    ] = None,
    components: Annotated[
        int | None,
        typer.Option(help="How many principal components a face has; default: 8, the paper: 5."),
    ] = None,
    markers: Annotated[
        str | None,
        typer.Option(
            help="The points of a face: 39, 47 (default) or 478, or a JSON file (docs/motion.md)."
        ),
    ] = None,
    phonemes: Annotated[
        Phonemes,
        typer.Option(
            help="Learn from the labels and from what the shipped recogniser hears (both), or from "
            "the labels alone (true), which is quicker."
        ),
    ] = "both",
    skip_bad: SkipBad = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Learn a face model from recorded speech with mouth motion.

    CORPUS holds audio/NAME.flac, landmarks/NAME.npz and labels/NAME.TextGrid of each sentence, and
    landmarks.json: docs/motion.md, "A corpus of your own", says what is in them.
    """
    from lipsync.corpus.grid import read_grid
    from lipsync.expectation.training.hearing import hear_sentences
    from lipsync.face.model_file import is_model
    from lipsync.markers import MARKERS_47, find_layout
    from lipsync.recognition.weights import load_shipped_weights
    from lipsync.training.face_training import DEFAULT_COMPONENTS, check_components
    from lipsync.training.face_training import train as train_model
    from lipsync.training.trained_model import save_model

    layout = MARKERS_47 if markers is None else find_layout(markers)
    n_components = DEFAULT_COMPONENTS if components is None else components
    check_components(n_components, layout)
    check_output(output, replaces=is_model, kind="face model")
    with _progress(quiet=quiet) as progress:
        reading = progress.add_task("reading", total=None)

        def read(names: list[str]) -> Iterable[str]:
            yield from progress.track(names, task_id=reading)

        sentences = read_grid(corpus, layout, skip_bad=skip_bad, progress=read)
        heard = None
        if phonemes == "both":
            heard = hear_sentences(
                load_shipped_weights(),
                sentences.labelled().utterances,
                lambda utterances: progress.track(utterances, description="listening"),
            )
        learning = progress.add_task("training", total=None)
        model = train_model(
            sentences,
            seed=seed,
            n_components=n_components,
            n_animphos=animphos,
            heard=heard,
            progress=lambda step: progress.update(learning, description=step),
        )
    save_model(model, output)
    for line in sentences.skipped:
        MESSAGES.print(f"left out: {line}", soft_wrap=True)
    figures: dict[str, object] = {
        "model": str(output),
        "sentences": len(model.training_sentences),
        "layout": layout.name,
        "points": layout.n_points,
        "components": model.n_components,
        "animphos": len(model.animphos),
        "mean_successors": model.animphos.mean_successors,
        "skipped": len(sentences.skipped),
        **model.provenance,
    }
    if as_json:
        print_json(figures)
        return
    RESULTS.print(
        f"{output}: {model.n_components} components of {layout.n_points} points, "
        f"{len(model.animphos)} AnimPhos from {model.provenance['segments']} segments of "
        f"{len(model.training_sentences)} sentences, {model.animphos.mean_successors:.2f} "
        f"successors on average (the paper: 3.45), {model.provenance['variance_held']:.1%} of "
        "the variance held",
        soft_wrap=True,
    )


@contextmanager
def _progress(*, quiet: bool) -> Iterator[Progress]:
    with Progress(console=MESSAGES, transient=True, disable=quiet) as progress:
        yield progress
