"""Options that several commands of the lab have in common."""

from pathlib import Path
from typing import Annotated

import typer

GridCorpus = Annotated[Path, typer.Option("--corpus", help="Folder laid out like grid_s1.")]
Speakers = Annotated[str, typer.Option(help="Only these, with commas between.")]
Limit = Annotated[
    int | None, typer.Option(min=1, help="Only the first utterances of each speaker.")
]
Cache = Annotated[
    Path | None, typer.Option(help="File of alignments, as `lipservo lines align` writes it.")
]
LatencyMs = Annotated[float, typer.Option(help="When a frame's label is due.")]
LookaheadsMs = Annotated[str, typer.Option("--lookahead-ms", help="Look-aheads, comma between.")]
Plots = Annotated[
    Path | None, typer.Option(help="Draw pictures into this folder.", show_default=False)
]
WordLimit = Annotated[
    int, typer.Option(min=1, help="--leave-words-out: at most so many sentences of each word.")
]
OtherWeights = Annotated[
    list[Path] | None,
    typer.Option(
        "--also",
        metavar="FILE",
        help="Other weights, older or adapted, that hear the sentences too, so that the map from "
        "posteriors leans on no one's errors; may be repeated. Of a bench: with --leave-words-out.",
        show_default=False,
    ),
]
ModelOutput = Annotated[Path, typer.Option("--output", "-o", help="The model file to write.")]
WeightsOutput = Annotated[Path, typer.Option("--output", "-o", help="The weights to write.")]
Seed = Annotated[int, typer.Option(help="The same seed gives the same result.")]
Jobs = Annotated[
    int | None,
    typer.Option(
        min=1, help="Processes, and threads of learning; default: one a core.", show_default=False
    ),
]
Lazy = Annotated[int, typer.Option(min=0, max=1000, help="Who do not, of each of three kinds.")]
Inverted = Annotated[int, typer.Option(min=0, max=1000, help="Who read the scale backwards.")]
