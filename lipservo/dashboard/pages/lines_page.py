"""The page of lines: the sounds and performances that a face can speak."""

from collections.abc import Mapping
from typing import Any, Final

from lipservo.dashboard.pages.page_frame import card, command, html

SCRIPTS: Final = ("lines.js",)
#: Starts a face that can play its lines.
COMMAND: Final = "lipservo daemon --config FACE --play --sounds FOLDER --dashboard"


def lines_page(status: Mapping[str, Any] | None) -> None:
    """Its content. status: the face's newest, None before its first."""
    folder = (status or {}).get("sounds")
    hint = f"sound files in {folder}" if folder else ""
    with card("Lines", hint, "lines"):
        if folder:
            html("<face-lines></face-lines>")
        else:
            html(_no_folder(), "empty")


def _no_folder() -> str:
    return (
        "<p>This face has no folder of sound files, or no voice to speak them with.</p>"
        f"<p>Start it with one:</p>{command(COMMAND)}"
        "<p>WAV, FLAC, OGG and MP3 files of that folder, and performances, appear here, to be "
        "played, uploaded and deleted.</p>"
    )
