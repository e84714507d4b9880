"""`lipservo bench motion`: our motion and its rivals' against recorded faces."""

import time
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.progress import Progress
from rich.table import Table

from lipservo.commands.options import Json, Quiet, SkipBad
from lipservo.output import MESSAGES, RESULTS, machine_class, print_json

if TYPE_CHECKING:
    from lipservo.motion_figures import Question
    from lipsync.animpho.model import FaceModel
    from lipsync.corpus.utterance import Corpus, Utterance


def motion(
    corpus: Annotated[Path, typer.Option(help="Folder laid out like grid_s1.")],
    model: Annotated[
        Path | None,
        typer.Option(
            help="Score this model on the folder; without it, cross-validate by splits.json. "
            "`shipped` names the shipped one.",
            show_default=False,
        ),
    ] = None,
    words: Annotated[
        str | None,
        typer.Option(help="Score these words alone, comma between; without --model unseen."),
    ] = None,
    strategy: Annotated[str | None, typer.Option(help="Score one method only.")] = None,
    lookahead_ms: Annotated[str, typer.Option(help="Look-aheads, comma between.")] = "0,100,200",
    phonemes: Annotated[str, typer.Option(help="true, or recognized live.")] = "true",
    plots: Annotated[
        Path | None, typer.Option(help="Draw pictures into this folder.", show_default=False)
    ] = None,
    skip_bad: SkipBad = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure synthesised motion against recorded faces, ours and its rivals."""
    from lipservo import motion_figures as measure
    from lipservo.motion_plots import check_plots
    from lipsync.animpho.live import LIVE_STRATEGY
    from lipsync.animpho.model import load_model, load_shipped_model

    began_s = time.perf_counter()
    if plots is not None:
        check_plots(plots)
    asked = measure.question(strategy, lookahead_ms, phonemes, words)
    given = None
    if model is not None:
        given = load_shipped_model() if str(model) == "shipped" else load_model(model)
    with Progress(console=MESSAGES, transient=True, disable=quiet) as progress:
        answer = _answer(corpus, given, asked, plots, progress, skip_bad=skip_bad)
    seconds = time.perf_counter() - began_s
    answer |= {"default_strategy": LIVE_STRATEGY, "machine": machine_class(), "seconds": seconds}
    if as_json:
        print_json(answer)
        return
    _print_rows(answer["results"])
    RESULTS.print(f"default strategy: {LIVE_STRATEGY}; {machine_class()}; {seconds:.0f} s")


def _answer(
    folder: Path,
    given: "FaceModel | None",
    asked: "Question",
    plots: Path | None,
    progress: Progress,
    *,
    skip_bad: bool,
) -> dict[str, Any]:
    """Rows, and with a given model the paper's tables; pictures on the way."""
    from lipservo import motion_figures as measure
    from lipsync.animpho.training import train
    from lipsync.corpus.grid import read_grid
    from lipsync.evaluation.scoring import seen_in_training
    from lipsync.expectation.hearing import hear_sentences
    from lipsync.recognition.weights import load_shipped_weights

    sentences = read_grid(
        folder,
        head_reference_mm=None if given is None else given.head_reference_mm,
        skip_bad=skip_bad,
        progress=lambda names: progress.track(names, description="reading"),
    )

    def track(what: str, items: "Sequence[Utterance]") -> "Iterable[Utterance]":
        return progress.track(items, description=what)

    heard = None
    if given is None:  # once for all trainings: the recogniser has heard no sentence of the folder
        labelled = sentences.labelled().utterances
        heard = hear_sentences(load_shipped_weights(), labelled, partial(track, "listening"))
    step = progress.add_task("training", total=None, visible=given is None)

    def learn(part: "Corpus") -> "FaceModel":
        return train(
            part, heard=heard, progress=lambda text: progress.update(step, description=text)
        )

    if given is None:
        rows, paper = measure.cross_validate(folder, sentences, asked, learn, track), None
    else:
        rows = measure.score_model(given, sentences, asked, track)
        paper = measure.paper_rows(given, sentences)
        seen = seen_in_training(given, sentences.utterances)
        if seen:
            MESSAGES.print(f"{len(seen)} sentences trained this model: figures flatter it")
    if plots is not None:
        from lipservo.motion_plots import draw

        drawn = given or learn(sentences.labelled())
        draw(plots, drawn, sentences.labelled().utterances, rows)
    return {"results": rows, "paper": paper, "skipped": list(sentences.skipped)}


def _print_rows(rows: Sequence[Mapping[str, object]]) -> None:
    columns = (
        "split strategy lookahead_ms rmse_mm ratio gap_r closure_hits false_closures_ratio "
        "acceleration_ratio miss_rate sentences frames"
    )
    table = Table(*columns.split())
    for row in rows:
        cells = (row[name] for name in columns.split())
        table.add_row(*(f"{c:.3f}" if isinstance(c, float) else str(c or "") for c in cells))
    RESULTS.print(table)
