"""Options that several commands of the lab have in common."""

from pathlib import Path
from typing import Annotated

import typer

GridCorpus = Annotated[
    Path, typer.Option("--corpus", help="One speaker's recordings, a folder as in docs/motion.md.")
]
TextCorpus = Annotated[
    Path,
    typer.Option(
        "--corpus", help="Folder of recordings with texts (docs/recognition.md, Corpora)."
    ),
]
TextCorpusOrClip = Annotated[
    Path | None,
    typer.Option(
        "--corpus",
        help="Folder of recordings with texts (docs/recognition.md, Corpora); default: the "
        "bundled clip.",
    ),
]
Speakers = Annotated[str, typer.Option(help="Speakers to use, commas between; default: all.")]
Limit = Annotated[
    int | None,
    typer.Option(
        min=1, help="Number of utterances of each speaker to use, from the first; default: all."
    ),
]
Cache = Annotated[
    Path | None, typer.Option(help="File that keeps alignments, as `lines align-folder` writes.")
]
LatencyMs = Annotated[
    float, typer.Option(help="Recogniser's delay: ms from a sound until its phoneme is read.")
]
LookaheadsMs = Annotated[
    str,
    typer.Option(
        "--lookahead-ms", help="How much following sound the motion may use, ms; commas between."
    ),
]
Plots = Annotated[Path | None, typer.Option(help="Folder to draw pictures into.")]
Words = Annotated[
    str | None,
    typer.Option(
        help="Score only these words, commas between; unless a model is given, one is trained "
        "first, without these words."
    ),
]
LeaveWordsOut = Annotated[
    bool,
    typer.Option(
        "--leave-words-out",
        help="Score every word of the corpus, each with one of ten models that was trained "
        "without it. The models are kept in the user's cache.",
    ),
]
WordLimit = Annotated[
    int, typer.Option(min=1, help="With --leave-words-out: most sentences scored for each word.")
]
OtherWeights = Annotated[
    list[Path] | None,
    typer.Option(
        "--also",
        metavar="FILE",
        help="Weights file of a further recogniser (older or adapted) to learn from too, so that "
        "the face model does not fit one recogniser's errors; may be repeated. In `bench` only "
        "with --leave-words-out.",
    ),
]
ModelOutput = Annotated[Path, typer.Option("--output", "-o", help="Model file to write, .npz.")]
WeightsOutput = Annotated[Path, typer.Option("--output", "-o", help="Weights file to write, .npz.")]
Seed = Annotated[int, typer.Option(help="Random seed; the same seed gives the same result.")]
Jobs = Annotated[
    int | None,
    typer.Option(min=1, help="Number of processes and of training threads; default: one per core."),
]
Lazy = Annotated[
    int,
    typer.Option(
        min=0,
        max=1000,
        help="Number of careless raters of each kind: equal, random, hasty answers.",
    ),
]
Inverted = Annotated[int, typer.Option(min=0, max=1000, help="Raters who reverse the scale.")]
