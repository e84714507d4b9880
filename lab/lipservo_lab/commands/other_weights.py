"""`--also`: weights, older or adapted, that hear a corpus beside the recogniser in use."""

from pathlib import Path
from typing import Annotated

import typer

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
