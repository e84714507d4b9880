"""Files that a command writes: refused before the work begins, and written whole or not at all.

While it is written a file is called `NAME.partial`, in the same folder; it is renamed when it is
complete and on the disk. A write that fails or is interrupted deletes the partial file and leaves
an earlier file of that name as it was.
"""

import errno
import os
import stat
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from lipsync.errors import UserError

PARTIAL_SUFFIX = ".partial"
#: So much of a file that is there tells what kind of file it is.
_HEAD_BYTES = 4096


class OutputError(UserError):
    """Error for a path that cannot be written to; the message says why and what to do."""


def nothing(_head: bytes) -> bool:
    """Return False: as the argument `replaces` of `check_output`, let no file be replaced."""
    return False


def check_output(
    path: Path,
    *,
    replaces: Callable[[bytes], bool] = nothing,
    kind: str = "",
    inputs: Iterable[Path | None] = (),
) -> None:
    """Raise OutputError if a file could not be written to `path` later; leave no file behind.

    replaces: returns whether an existing file may be replaced, given its first 4096 bytes; an empty
    file always may. kind: the files that `replaces` accepts, in words, for the error message.
    inputs: files that the command reads, which are never written over.
    """
    try:
        place = _real_path(path)
        status = place.stat() if place.exists() else None
        if status is not None:
            _check_existing(path, place, status, replaces, kind, inputs)
        with _open_partial(place):
            pass
        _partial_path(place).unlink()
    except OutputError:
        raise
    except (OSError, ValueError) as error:  # ValueError: a name with a zero byte
        raise _explained_error(path, error) from error


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Yield a temporary path to write to; rename that file to `path` at the end.

    On any exception the temporary file is deleted instead. Raises OutputError where the file cannot
    be written, for example on a full disk.
    """
    try:
        place = _real_path(path)
        partial = _partial_path(place)
        with _open_partial(place):
            pass
        try:
            yield partial
            _flush(partial)
            os.replace(partial, place)
        except BaseException:
            partial.unlink(missing_ok=True)
            raise
        _flush(place.parent)
    except OSError as error:
        raise _explained_error(path, error) from error


def write_whole(path: Path, content: str | bytes) -> None:
    """Write all of `content` (text as UTF-8) to a file, or nothing. Raises OutputError."""
    with written_whole(path) as partial:
        partial.write_bytes(content.encode() if isinstance(content, str) else content)


def _real_path(path: Path) -> Path:
    """Return the real path of a file, symbolic links resolved. Raises OSError for a link loop."""
    place = Path(os.path.realpath(path))
    if place.is_symlink():
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP))
    return place


def _partial_path(place: Path) -> Path:
    return place.with_name(place.name + PARTIAL_SUFFIX)


@contextmanager
def _open_partial(place: Path) -> Iterator[None]:
    """Create the partial file of `place`, deleting an earlier one; two writers never share it."""
    partial = _partial_path(place)
    partial.unlink(missing_ok=True)
    descriptor = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
    try:
        yield
    finally:
        os.close(descriptor)


def _check_existing(
    path: Path,
    place: Path,
    status: os.stat_result,
    replaces: Callable[[bytes], bool],
    kind: str,
    inputs: Iterable[Path | None],
) -> None:
    """Raise OutputError unless the existing file may be replaced, as in `check_output`.

    path: as the user wrote it, for messages; place: the same with links resolved; status: of the
    file there.
    """
    if stat.S_ISDIR(status.st_mode):
        raise OutputError(f"{path}: is a folder; name a file in it")
    if not stat.S_ISREG(status.st_mode):
        raise OutputError(f"{path}: is a device or a pipe, not a file; choose another name")
    for each in inputs:
        if each is not None and each.exists() and place.samefile(each):
            raise OutputError(f"{path}: is an input of this command; choose another output name")
    with place.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    if head and not replaces(head):
        other = f" and is no {kind}" if kind else ""
        raise OutputError(f"{path}: exists already{other}; choose another name")


def _flush(path: Path) -> None:
    """Flush a file or folder to the disk; for folders, ignore file systems that refuse it."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    except OSError:
        if not path.is_dir():
            raise
    finally:
        os.close(descriptor)


def _explained_error(path: Path, error: OSError | ValueError) -> OutputError:
    reason = error.strerror if isinstance(error, OSError) else str(error)
    if isinstance(error, FileNotFoundError) and not path.parent.is_dir():
        reason = f"there is no folder {path.parent}"
    return OutputError(f"{path}: cannot be written: {reason}")
