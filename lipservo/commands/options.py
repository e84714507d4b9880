"""Options that several commands share."""

from pathlib import Path
from typing import Annotated

import typer

from lipsync.errors import UserError

Config = Annotated[
    str, typer.Option(help="Face: the name of a shipped one, or the path of a YAML file.")
]
Model = Annotated[
    Path | None,
    typer.Option(help="Face model (.npz); default: the shipped one.", show_default=False),
]
Port = Annotated[
    str | None,
    typer.Option(help="Serial port of the servos; default: the face's.", show_default=False),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No live view, no messages.")]
SkipBad = Annotated[
    bool, typer.Option("--skip-bad", help="Leave out sentences with a bad file, and list them.")
]
DEFAULT_FACE = "face_sim"


def port_of(given: str | None, of_the_face: str | None) -> str:
    """The port to open. Raises UserError when there is none."""
    port = given or of_the_face
    if port is None:
        raise UserError("no port: give --port, or write `bus: {kind: dynamixel, port: ...}`")
    return port
