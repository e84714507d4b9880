"""`lipservo bench readability`: which words a reader of recorded faces reads off our motion."""

import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from lipservo.commands.options import Json, Quiet, SkipBad
from lipservo.settings.motion_names import DEFAULT_STRATEGY
from lipservo.terminal.output import RESULTS, machine_class, print_json
from lipservo_lab.commands.bench.printing import print_table
from lipservo_lab.commands.options import (
    GridCorpus,
    LeaveWordsOut,
    LookaheadsMs,
    OtherWeights,
    Plots,
    WordLimit,
    Words,
)
from lipservo_lab.commands.work_bars import WorkBars, work_bars
from lipsync.errors import check_inputs

if TYPE_CHECKING:
    from lipservo_lab.bench.motion_figures import Row
    from lipservo_lab.bench.readability.readability_figures import ReadingQuestion
    from lipservo_lab.evaluation.motion.offline_methods import OfflineModels

#: What is printed of a row, and its heading; all of it together fits 80 columns. JSON has the rest.
_COLUMNS = {
    "split": "split",
    "face": "face",
    "phonemes": "phonemes",
    "strategy": "strategy",
    "lookahead_ms": "ms",
    "reader": "reader",
    "score": "read",
    "score_95": "95 %",
    "whole_sentences": "whole",
    "gain": "gain",
}


def readability(
    corpus: GridCorpus,
    words: Words = None,
    models: Annotated[
        Path | None,
        typer.Option(
            help="Folder of face models, trained without what is read: known.npz (known words), "
            "a.npz, b.npz (new words, sets A and B), words.npz (--words). Default: train them now."
        ),
    ] = None,
    leave_words_out: LeaveWordsOut = False,
    limit: WordLimit = 20,
    strategy: Annotated[
        str,
        typer.Option(
            help="Methods of motion, commas between: those of `bench motion`, and of `lines "
            "render` heard and model-based."
        ),
    ] = f"{DEFAULT_STRATEGY},expected,priority",
    lookahead_ms: LookaheadsMs = "0,100,200",
    phonemes: Annotated[
        str,
        typer.Option(
            help="Sources, commas between: true (labels), recognized (live), text (live, by text)."
        ),
    ] = "true,recognized",
    robot: Annotated[
        bool, typer.Option(help="Also read trained words off the simulated robot's joint angles.")
    ] = True,
    plots: Plots = None,
    also: OtherWeights = None,
    skip_bad: SkipBad = False,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure how many words automatic lip-readers read off the mouth's motion.

    The lip-readers are classifiers that are trained on the recorded faces. Without --words and
    --leave-words-out they read the test sentences in splits.json: known words, and words that the
    model has not learned.
    """
    from lipservo.terminal.pictures import check_folder
    from lipservo_lab.bench.readability.readability_figures import (
        PICTURES,
        draw_readability,
        headline,
        reading_question,
    )

    began_s = time.perf_counter()
    check_inputs(corpus)
    if plots is not None:
        check_folder(plots, PICTURES)
    if leave_words_out and (words is not None or models is not None):
        raise typer.BadParameter(
            "--leave-words-out trains models of its own; leave out --words and --models"
        )
    if also and not leave_words_out:
        raise typer.BadParameter("--also needs --leave-words-out, which trains the models")
    reading = reading_question(strategy, lookahead_ms, phonemes, robot=robot)
    with work_bars(quiet=quiet) as bars:
        rows, skipped = _measured(
            corpus, words, models, reading, bars,
            skip_bad=skip_bad, most_left_out=limit if leave_words_out else None,
            others=also or (),
        )  # fmt: skip
    if plots is not None:
        draw_readability(plots, rows)
    seconds = time.perf_counter() - began_s
    about = {"default_strategy": DEFAULT_STRATEGY, "machine": machine_class(), "seconds": seconds}
    if as_json:
        print_json({**headline(rows), "results": rows, "skipped": skipped, **about})
        return
    print_table(rows, _COLUMNS, title="Readability")
    RESULTS.print(f"default strategy: {DEFAULT_STRATEGY}; {machine_class()}; {seconds:.0f} s")


def _measured(
    folder: Path,
    words: str | None,
    models: Path | None,
    reading: "ReadingQuestion",
    bars: WorkBars,
    *,
    skip_bad: bool,
    most_left_out: int | None,
    others: Sequence[Path],
) -> "tuple[list[Row], list[str]]":
    """Return the rows, and which sentences of the corpus were left out.

    most_left_out: sentences of each word, each read by a model without the word; None: `words`, or
    the folder's own splits. others: files of weights that recognise the sentences too.
    """
    from lipservo_lab.bench.readability.left_out_reading import left_out_parts
    from lipservo_lab.bench.readability.readability_figures import reading_rows, with_line_methods
    from lipservo_lab.bench.readability.reading_models import (
        given_models,
        kept_models,
        requested_parts,
        trained_models,
    )
    from lipservo_lab.corpus.grid import read_grid
    from lipsync.markers import MARKERS_47

    sentences = read_grid(folder, MARKERS_47, skip_bad=skip_bad, progress=bars.read)
    labelled = sentences.labelled()
    if most_left_out is None:
        parts = requested_parts(folder, labelled, words)
    else:
        parts = left_out_parts(labelled, most_left_out)
    if models is not None:
        model_of = given_models(models, parts)
    elif most_left_out is None:
        model_of = trained_models(labelled, bars.track, bars.tell)
    else:
        model_of = kept_models(labelled, bars.track, bars.tell, others)

    def models_of_lines() -> "OfflineModels":
        from lipservo_lab.bench.offline_models import models_of

        return models_of(labelled, "bench readability of a method of `render`")

    reading = with_line_methods(reading, models_of_lines)
    rows = reading_rows(
        labelled,
        parts,
        model_of,
        reading,
        bars.track,
        bars.advance,
        is_pooled=most_left_out is not None,
    )
    return rows, list(sentences.skipped)
