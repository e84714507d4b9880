"""The lines that a face plays, sounds and performances: a folder, whose files have plain names.

Files that are uploaded are written off the event loop, and whole or not at all: a slow card takes
seconds for one `fsync`, and nothing else of the dashboard, its stop least of all, waits for that.
Each upload is written in a thread of its own, and there are few.

All functions raise FaceError, one line, with the code refused, not_found, not_sound or
not_available; an upload also busy, exists, too_large, stalled.
"""

import asyncio
import contextlib
import os
import stat
import tempfile
import threading
import time
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, Final

from lipservo_client.protocol import FaceError

from lipsync.errors import UserError, shown
from lipsync.offline.performance import SUFFIX as PERFORMANCE_SUFFIX
from lipsync.offline.performance import read_performance

MOST_BYTES: Final = 50_000_000
#: What libsndfile reads, by the endings that people give it, and what `lines render` writes.
SUFFIXES: Final = (".wav", ".flac", ".ogg", ".opus", ".mp3", ".aif", ".aiff", PERFORMANCE_SUFFIX)
_LONGEST_NAME_BYTES: Final = 200
_MOST_LISTED: Final = 1000
#: Prefix of the name of an upload that is not whole: no line's name may begin with a dot.
COMING: Final = ".coming-"
MOST_AT_ONCE: Final = 4
#: An upload is given up when its client sends nothing for 10 s, or needs more than 5 minutes: 50 MB
#: take as long at 0.17 MB/s.
_STALLED_S: Final = 10.0
_LONGEST_S: Final = 300.0
#: Unfinished files older than this, of a dashboard that was killed, are removed at an upload.
_LEFT_S: Final = 3600.0


def checked_name(name: str) -> str:
    """Return `name` if it may be a line's: a plain file name, 200 bytes at most, known ending.

    Otherwise raise FaceError `refused`.
    """
    try:
        n_bytes = len(name.encode())
    except UnicodeEncodeError:
        raise FaceError("refused", f"{shown(name)} cannot be a file name") from None
    if not name or n_bytes > _LONGEST_NAME_BYTES:
        raise FaceError("refused", f"a file name must have 1 to {_LONGEST_NAME_BYTES} bytes")
    is_allowed = name.isprintable() and not set(name) & set('/\\:*?"<>|')
    if not is_allowed or name.startswith((".", " ", "-")) or name.endswith((".", " ")):
        raise FaceError("refused", f"{shown(name)}: use letters, digits, spaces and dashes")
    if Path(name).suffix.lower() not in SUFFIXES:
        raise FaceError("refused", f"{shown(name)}: must end in {' or '.join(SUFFIXES)}")
    return name


class SoundLines:
    """The lines (sound files and performances) of the folder that a face plays from."""

    def __init__(self, folder: Path | None) -> None:
        """Use this folder; None: the face plays no files, and every method raises FaceError."""
        self._folder = folder

    def listed(self) -> list[dict[str, Any]]:
        """Return {name, n_bytes, changed_s (since 1970)} of each line, by name; 1000 at most.

        Empty where the folder cannot be read.
        """
        lines = []
        with contextlib.suppress(OSError), os.scandir(self._checked_folder()) as entries:
            for entry in entries:
                # A file whose name no line may have is left out.
                with contextlib.suppress(OSError, FaceError):
                    info = entry.stat(follow_symlinks=False)
                    if stat.S_ISREG(info.st_mode):
                        name = checked_name(entry.name)
                        lines.append(
                            {"name": name, "n_bytes": info.st_size, "changed_s": info.st_mtime}
                        )
        return sorted(lines, key=lambda line: str(line["name"]))[:_MOST_LISTED]

    def existing_path(self, name: str) -> Path:
        """Return the path of the sound file or performance `name`.

        Raises FaceError `not_found` if there is no such regular file, links not followed.
        """
        path = self.target_path(name)
        try:
            is_file = stat.S_ISREG(path.lstat().st_mode)
        except OSError:
            is_file = False
        if not is_file:
            raise FaceError("not_found", f"no file of the face is called {shown(name)}")
        return path

    def remove(self, name: str) -> None:
        """Delete the sound file or performance `name`. Raises FaceError where that fails."""
        try:
            self.existing_path(name).unlink()
        except OSError as error:
            raise FaceError("refused", f"{shown(name)}: {error.strerror}") from error

    def target_path(self, name: str) -> Path:
        """Return the path that a sound file or performance `name` has, existing or not.

        Raises FaceError for a name that none may have.
        """
        return self._checked_folder() / checked_name(name)

    def _checked_folder(self) -> Path:
        if self._folder is None:
            hint = "start it with `--sounds FOLDER`"
            raise FaceError("not_available", f"this face plays no files: {hint}")
        return self._folder


def check_sound(path: Path, name: str) -> None:
    """Raise FaceError unless the file is a sound or a performance. name: for the message."""
    from lipsync.audio.file import checked_sound

    try:
        if path.suffix.lower() == PERFORMANCE_SUFFIX:
            read_performance(path)  # the face that plays it checks whether it fits
        else:
            checked_sound(path)
    except UserError as error:
        why = str(error).replace(str(path), name).replace(path.name, name)
        raise FaceError("not_sound", " ".join(why.split())) from error


class Uploads:
    """The uploads of one dashboard, 4 at most at a time, in one event loop."""

    def __init__(self) -> None:
        self._threads = ThreadPoolExecutor(MOST_AT_ONCE, thread_name_prefix="dashboard upload")
        self._n_uploads = 0

    async def store(
        self, place: Path, chunks: AsyncIterator[bytes], *, replace: bool = False
    ) -> dict[str, Any]:
        """Write an upload to disk; the file appears at `place` once whole and checked.

        Parameters
        ----------
        place : the path of the finished file, from `SoundLines.target_path`.
        chunks : its bytes; what iterating raises is raised, and nothing is left behind.
        replace : whether an existing file may be replaced.

        Returns
        -------
        {"name", "n_bytes"}

        Raises
        ------
        FaceError
            busy, exists, too_large, not_sound, stalled, not_available.
        """
        if self._n_uploads >= MOST_AT_ONCE:
            raise FaceError("busy", f"{MOST_AT_ONCE} files are being uploaded; try again later")
        self._n_uploads += 1
        try:
            return await self._store(place, chunks, replace=replace)
        except TimeoutError:
            stalled = f"{shown(place.name)}: came too slowly, and was given up"
            raise FaceError("stalled", stalled) from None
        except OSError as error:
            raise FaceError("not_available", f"file not written: {error.strerror}") from error
        finally:
            self._n_uploads -= 1

    async def _store(
        self, target: Path, chunks: AsyncIterator[bytes], *, replace: bool
    ) -> dict[str, Any]:
        """Write an upload to a temporary file, moved to `target` once it is whole and checked.

        The disk is used in threads. The temporary file is removed in every case. Returns {"name",
        "n_bytes"}. Raises FaceError, OSError, and TimeoutError for a client that stalls for 10 s or
        needs more than 5 minutes.
        """
        run_in_thread = partial(asyncio.get_running_loop().run_in_executor, self._threads)
        upload = await run_in_thread(partial(_UnfinishedFile, target, replace=replace))
        n_bytes = 0
        try:
            async with asyncio.timeout(_LONGEST_S):
                while (chunk := await _next_chunk(chunks)) is not None:
                    n_bytes += len(chunk)
                    if n_bytes > MOST_BYTES:
                        raise FaceError("too_large", f"over {MOST_BYTES // 10**6} MB")
                    await run_in_thread(upload.write, chunk)
            await run_in_thread(upload.finish)
        except asyncio.CancelledError:
            # The server ends: the file is removed in a thread, for which nothing waits.
            run_in_thread(upload.close)
            raise FaceError("busy", "the dashboard is ending; upload the file again") from None
        except BaseException:
            await run_in_thread(upload.close)
            raise
        await run_in_thread(upload.close)
        return {"name": target.name, "n_bytes": n_bytes}


async def _next_chunk(chunks: AsyncIterator[bytes]) -> bytes | None:
    """Return the next bytes of an upload; None at its end. Raises TimeoutError after 10 s."""
    async with asyncio.timeout(_STALLED_S):
        return await anext(chunks, None)


def _remove_leftovers(folder: Path) -> None:
    """Delete unfinished uploads in `folder` that are older than an hour."""
    for path in folder.glob(f"{COMING}*"):
        with contextlib.suppress(OSError):
            if time.time() - path.lstat().st_mtime > _LEFT_S:
                path.unlink()


class _UnfinishedFile:
    """An upload that is not whole yet, under a temporary name in its folder. Used in threads."""

    def __init__(self, place: Path, *, replace: bool) -> None:
        """Create an empty temporary file beside `place`, the path of the finished file.

        Raises FaceError `exists` if there is such a file, unless `replace`; OSError.
        """
        if place.exists() and not replace:
            raise FaceError("exists", f"{shown(place.name)} already exists")
        _remove_leftovers(place.parent)
        self._target = place
        self._replace = replace
        # `close` may be called while a write of an upload that was given up still runs.
        self._lock = threading.Lock()
        fd, partial_path = tempfile.mkstemp(place.suffix, COMING, place.parent)
        self._path = Path(partial_path)
        self._file = os.fdopen(fd, "wb")

    def write(self, chunk: bytes) -> None:
        with self._lock:
            self._file.write(chunk)

    def finish(self) -> None:
        """Flush the file to disk, check that it can be played, and give it its final name.

        Raises FaceError `not_sound`, or `exists` if another file has that name by now.
        """
        with self._lock:
            self._file.flush()
            os.fsync(self._file.fileno())
            check_sound(self._path, self._target.name)
            self._path.chmod(0o644)
            if self._replace:
                self._path.replace(self._target)
                return
            try:
                # Unlike a rename, this never takes another file's place.
                os.link(self._path, self._target)
            except FileExistsError as error:
                raise FaceError("exists", f"{shown(self._target.name)} already exists") from error

    def close(self) -> None:
        """Close and delete the temporary file."""
        with self._lock:
            try:
                self._file.close()
            finally:
                self._path.unlink(missing_ok=True)
