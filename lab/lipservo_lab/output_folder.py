"""Folders that a command writes: refused before the work, and written whole or not at all."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from lipsync.output_file import PARTIAL_SUFFIX, OutputError


def check_output_folder(folder: Path, what: str) -> None:
    """Refuse a place where no folder could be written later.

    what: its content, for the message. Raises OutputError.
    """
    if folder.is_dir() and not any(folder.iterdir()):
        return
    if folder.exists():
        raise OutputError(f"{folder}: exists already; choose another name for the {what}")
    parent = folder.absolute().parent
    if not parent.is_dir() or not os.access(parent, os.W_OK):
        raise OutputError(f"{folder}: cannot be written: {parent} is no folder to write in")


@contextmanager
def folder_written_whole(folder: Path) -> Iterator[Path]:
    """Yield a folder to write into, which gets the name `folder` at the end.

    If anything is raised the folder is removed. `folder` may exist if empty. Raises OutputError.
    """
    partial = folder.with_name(folder.name + PARTIAL_SUFFIX)
    try:
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir()
        try:
            yield partial
            if folder.is_dir():
                folder.rmdir()  # empty, or it was refused
            os.replace(partial, folder)
        except BaseException:
            shutil.rmtree(partial, ignore_errors=True)
            raise
    except OSError as error:
        raise OutputError(f"{folder}: cannot be written: {error.strerror}") from error
