"""The lines that a face plays, sounds and performances: a folder, whose files have plain names.

Everything raises FaceError, one line: refused, not_found, not_sound, not_available. New files come
by `uploads.py`.
"""

import contextlib
import os
import stat
from pathlib import Path
from typing import Any, Final

from lipservo_client.face_answers import FaceError

from lipsync.errors import UserError, shown
from lipsync.offline.performance_file import SUFFIX as PERFORMANCE_SUFFIX
from lipsync.offline.performance_file import read_performance

MOST_BYTES: Final = 50_000_000
#: What libsndfile reads, by the endings that people give it, and what `lines render` writes.
SUFFIXES: Final = (".wav", ".flac", ".ogg", ".opus", ".mp3", ".aif", ".aiff", PERFORMANCE_SUFFIX)
_LONGEST_NAME_BYTES: Final = 200
_MOST_LISTED: Final = 1000
#: An upload that is not whole: begins with a dot, so that it is no line and cannot be played.
COMING: Final = ".coming-"


def checked_name(name: str) -> str:
    """A name that is a file of the folder itself and nothing else. Raises FaceError."""
    try:
        n_bytes = len(name.encode())
    except UnicodeEncodeError:
        raise FaceError("refused", f"{shown(name)}: is no name of a file") from None
    if not name or n_bytes > _LONGEST_NAME_BYTES:
        raise FaceError("refused", f"a name has 1 to {_LONGEST_NAME_BYTES} bytes")
    is_plain = name.isprintable() and not set(name) & set('/\\:*?"<>|')
    if not is_plain or name.startswith((".", " ", "-")) or name.endswith((".", " ")):
        raise FaceError("refused", f"{shown(name)}: write letters, digits, spaces and dashes")
    if Path(name).suffix.lower() not in SUFFIXES:
        raise FaceError("refused", f"{shown(name)}: ends in none of {' '.join(SUFFIXES)}")
    return name


class SoundLines:
    """The files of one folder."""

    def __init__(self, folder: Path | None) -> None:
        """folder: None: the face plays no files."""
        self._folder = folder

    def listed(self) -> list[dict[str, Any]]:
        """{name, n_bytes, changed_s} of each, by name; changed_s: seconds since 1970."""
        found = []
        with contextlib.suppress(OSError), os.scandir(self._place()) as entries:
            for entry in entries:
                with contextlib.suppress(OSError, FaceError):
                    about = entry.stat(follow_symlinks=False)
                    if stat.S_ISREG(about.st_mode):
                        name = checked_name(entry.name)
                        found.append(
                            {"name": name, "n_bytes": about.st_size, "changed_s": about.st_mtime}
                        )
        return sorted(found, key=_name)[:_MOST_LISTED]

    def path_of(self, name: str) -> Path:
        """A line that is there."""
        path = self.place_of(name)
        try:
            is_file = stat.S_ISREG(path.lstat().st_mode)
        except OSError:
            is_file = False
        if not is_file:
            raise FaceError("not_found", f"{shown(name)}: no such line")
        return path

    def remove(self, name: str) -> None:
        """Delete it."""
        try:
            self.path_of(name).unlink()
        except OSError as error:
            raise FaceError("refused", f"{shown(name)}: {error.strerror}") from error

    def place_of(self, name: str) -> Path:
        """Where a line of that name is to be."""
        return self._place() / checked_name(name)

    def _place(self) -> Path:
        if self._folder is None:
            hint = "start it with `--sounds FOLDER`"
            raise FaceError("not_available", f"this face plays no files: {hint}")
        return self._folder


def check_sound(path: Path, name: str) -> None:
    """Raise FaceError for what is neither a sound nor a performance. name: of it, for people."""
    from lipsync.audio.file import checked_rate_hz

    try:
        if path.suffix.lower() == PERFORMANCE_SUFFIX:
            read_performance(path)  # whether it is for this face, the face says that plays it
        else:
            checked_rate_hz(path)
    except UserError as error:
        why = str(error).replace(str(path), name).replace(path.name, name)
        raise FaceError("not_sound", " ".join(why.split())) from error


def _name(line: dict[str, Any]) -> str:
    return str(line["name"])
