"""`lipservo bench languages`: closures and openings heard in other languages than English."""

import tempfile
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from lipservo.commands.options import Json, MeasuredEngineChoice, Quiet, WeightsChoice
from lipservo.terminal.output import RESULTS, machine_class, print_json
from lipservo.terminal.progress_bar import progress_bar
from lipsync.recognition.weights import DEFAULT_WEIGHTS


def languages(
    languages: Annotated[
        str, typer.Option(help="Only these, with commas between: de,fr,ja.", show_default=False)
    ] = "",
    engine: MeasuredEngineChoice = "network",
    latency_ms: Annotated[float, typer.Option(help="When a frame's label is due.")] = 95.0,
    weights: WeightsChoice = DEFAULT_WEIGHTS,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure what is heard of languages that espeak-ng speaks, by its own phoneme times.

    Ten sentences each. Phonemes that English lacks are taken for those that look alike on the lips.
    """
    from lipservo_lab.bench.hearing.measured_recognizer import measured_recognizer
    from lipservo_lab.bench.hearing.spoken_languages import (
        language_scores,
        language_sentences,
        read_languages,
    )

    chosen = read_languages(languages)
    make = measured_recognizer(engine, latency_ms / 1e3, weights)
    n_sentences = sum(len(language_sentences()[tag]) for tag in chosen)
    n_done = 0
    with progress_bar(quiet=quiet) as advance, tempfile.TemporaryDirectory() as folder:

        def count() -> None:
            nonlocal n_done
            n_done += 1
            advance("speaking", n_done, n_sentences)

        scores = language_scores(chosen, make, Path(folder), count)
    figures = {tag: score.figures() for tag, score in scores.items()}
    if as_json:
        settings = {"engine": engine, "weights": weights, "latency_ms": latency_ms}
        print_json({"languages": figures, **settings, "machine": machine_class()})
        return
    columns = ("closure_recall", "closure_precision", "opening_recall", "opening_precision")
    table = Table("language", *(name.replace("_", " ") for name in columns), "visemes of speech")
    for tag, row in figures.items():
        table.add_row(tag, *(f"{row[name]:.2f}" for name in (*columns, "viseme_speech")))
    RESULTS.print(table)
