"""`lipservo bench texts`: how well `align` tells what was said from what was not."""

from pathlib import Path
from typing import Annotated

import typer

from lipservo.commands.options import Json, Quiet, WeightsChoice
from lipservo.terminal.output import RESULTS, machine_class, print_json
from lipservo.terminal.progress_bar import progress_bar
from lipservo_lab.commands.bench.recognition import Limit, Speakers
from lipsync.recognition.weights import DEFAULT_WEIGHTS, find_weights


def texts(
    corpus: Annotated[Path, typer.Option(help="Folder as for `bench recognition`.")],
    speakers: Speakers = "",
    limit: Limit = None,
    weights: WeightsChoice = DEFAULT_WEIGHTS,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure how often `align` refuses, doubts and passes true and false texts."""
    from lipservo_lab.bench.aligned_corpus import selected
    from lipservo_lab.evaluation.recognition.false_texts import score_texts, text_figures

    utterances = selected(corpus, speakers, limit=limit)
    learned = find_weights(weights)
    scores = []
    with progress_bar(quiet=quiet) as advance:
        for number, each in enumerate(score_texts(utterances, learned), start=1):
            scores.append(each)
            advance("aligning", number, len(utterances))
    figures = {**text_figures(scores), "weights": weights, "machine": machine_class()}
    if as_json:
        print_json(figures)
        return
    for name, value in figures.items():
        RESULTS.print(f"{name}: {value}", soft_wrap=True, highlight=False)
