"""Checks and writing of pictures that commands draw with matplotlib, the extra `plots`."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from lipsync.errors import UserError, check_extra
from lipsync.output_file import check_output, written_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DOTS_PER_INCH = 110
#: https://www.w3.org/TR/png-3/#5PNG-file-signature
_SIGNATURE = b"\x89PNG\r\n\x1a\n"


class PictureError(UserError):
    """A path at which pictures cannot be drawn."""


def check_picture(path: Path, inputs: Iterable[Path] = ()) -> None:
    """Check before the work that a picture can be written to `path`; only a picture is replaced.

    inputs: files that `path` must not be. Raises MissingExtraError or OutputError.
    """
    check_extra("matplotlib", "drawing pictures")
    check_output(path, replaces=is_picture, kind="PNG picture", inputs=inputs)


def check_folder(folder: Path, names: Iterable[str]) -> None:
    """Check before the work that pictures `names` can be written to a folder, new or existing.

    Raises PictureError, MissingExtraError or OutputError.
    """
    check_extra("matplotlib", "drawing pictures")
    if folder.is_dir():
        for name in names:
            check_picture(folder / name)
    elif folder.exists():
        raise PictureError(f"{folder}: is a file; give a folder for the pictures")
    else:
        # The uppermost folder that has to be made: its parent must allow that.
        to_create = next(path for path in (folder, *folder.parents) if path.parent.exists())
        check_output(to_create)


def without_screen() -> None:
    """Make matplotlib draw into files only, without a screen. Call before pyplot is imported."""
    import matplotlib as mpl

    mpl.use("Agg")


def save_picture(figure: "Figure", path: Path) -> None:
    """Write a figure as PNG, whole or not at all, and create its folder. Raises OutputError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(path) as partial:
        figure.savefig(partial, dpi=_DOTS_PER_INCH, format="png")


def is_picture(head: bytes) -> bool:
    """Return whether a file with these first bytes is a PNG picture."""
    return head.startswith(_SIGNATURE)
