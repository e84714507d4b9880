"""Options that several commands of the lab have in common."""

from pathlib import Path
from typing import Annotated

import typer

GridCorpus = Annotated[
    Path, typer.Option("--corpus", help="One speaker's recordings, a folder as in docs/motion.md.")
]
Speakers = Annotated[str, typer.Option(help="Only these speakers, with commas between.")]
Limit = Annotated[
    int | None, typer.Option(min=1, help="Only this many utterances of each speaker, the first.")
]
Cache = Annotated[
    Path | None, typer.Option(help="File that keeps alignments, as `lines align-folder` writes.")
]
LatencyMs = Annotated[float, typer.Option(help="Delay at which a frame's label is read, ms.")]
LookaheadsMs = Annotated[
    str, typer.Option("--lookahead-ms", help="Look-aheads, ms, such as 0,100.")
]
Plots = Annotated[Path | None, typer.Option(help="Draw pictures into this folder.")]
WordLimit = Annotated[
    int, typer.Option(min=1, help="With --leave-words-out: most sentences used for each word.")
]
OtherWeights = Annotated[
    list[Path] | None,
    typer.Option(
        "--also",
        metavar="FILE",
        help="Further recogniser weights (older or adapted) that recognise the sentences too, so "
        "that the model does not learn one recogniser's errors; may be repeated. In `bench` only "
        "with --leave-words-out.",
    ),
]
ModelOutput = Annotated[Path, typer.Option("--output", "-o", help="The model file to write.")]
WeightsOutput = Annotated[Path, typer.Option("--output", "-o", help="Weights file to write, .npz.")]
Seed = Annotated[int, typer.Option(help="Random seed; the same seed gives the same result.")]
Jobs = Annotated[
    int | None,
    typer.Option(min=1, help="Number of processes and of training threads; default: one per core."),
]
Lazy = Annotated[
    int, typer.Option(min=0, max=1000, help="Careless raters of each kind: alike, random, hasty.")
]
Inverted = Annotated[int, typer.Option(min=0, max=1000, help="Raters who reverse the scale.")]
