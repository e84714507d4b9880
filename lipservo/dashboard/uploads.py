"""Files that come in by the dashboard's API: written off the event loop, and whole or not at all.

A slow card takes seconds for one `fsync`. Nothing else of the dashboard, its stop least of all,
waits for that: each upload is written in a thread of its own, and there are few.
"""

import asyncio
import contextlib
import os
import tempfile
import threading
import time
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any, Final

from lipservo_client.face_answers import FaceError

from lipservo.dashboard.sound_lines import COMING, MOST_BYTES, check_sound
from lipsync.errors import shown

MOST_AT_ONCE: Final = 4
#: A client that sends nothing for so long, or is not done by then, is given up: 50 MB are done at
#: 0.17 MB/s.
_STALLED_S: Final = 10.0
_LONGEST_S: Final = 300.0
#: What a dashboard that was killed has left behind is removed at the next upload after that.
_LEFT_S: Final = 3600.0


class Uploads:
    """The uploads of one dashboard, a few at a time. Of one event loop."""

    def __init__(self) -> None:
        self._writing = ThreadPoolExecutor(MOST_AT_ONCE, thread_name_prefix="dashboard upload")
        self._n_coming = 0

    async def store(
        self, place: Path, chunks: AsyncIterator[bytes], *, replace: bool = False
    ) -> dict[str, Any]:
        """Write a file as it comes; it is at its place once it is whole and known to be sound.

        Parameters
        ----------
        place : where it is to be, from `SoundLines.place_of`.
        chunks : its bytes; what iterating raises is raised, and nothing is left behind.
        replace : whether it may take the place of another.

        Returns
        -------
        {"name", "n_bytes"}

        Raises
        ------
        FaceError
            busy, exists, too_large, not_sound, stalled, not_available.

        """
        if self._n_coming >= MOST_AT_ONCE:
            raise FaceError("busy", f"{MOST_AT_ONCE} files are coming in already; try again")
        self._n_coming += 1
        try:
            return await self._store(place, chunks, replace=replace)
        except TimeoutError:
            stalled = f"{shown(place.name)}: came too slowly, and was given up"
            raise FaceError("stalled", stalled) from None
        except OSError as error:
            raise FaceError("not_available", f"cannot write it: {error.strerror}") from error
        finally:
            self._n_coming -= 1

    async def _store(
        self, place: Path, chunks: AsyncIterator[bytes], *, replace: bool
    ) -> dict[str, Any]:
        in_thread = partial(asyncio.get_running_loop().run_in_executor, self._writing)
        coming = await in_thread(partial(_ComingFile, place, replace=replace))
        n_bytes = 0
        try:
            async with asyncio.timeout(_LONGEST_S):
                while (chunk := await _next_of(chunks)) is not None:
                    n_bytes += len(chunk)
                    if n_bytes > MOST_BYTES:
                        raise FaceError("too_large", f"more than {MOST_BYTES // 10**6} MB")
                    await in_thread(coming.write, chunk)
            await in_thread(coming.finish)
        except asyncio.CancelledError:
            # The server ends, and waits for no disk.
            in_thread(coming.close)
            raise FaceError("busy", "the dashboard ends; upload it again") from None
        except BaseException:
            await in_thread(coming.close)
            raise
        await in_thread(coming.close)
        return {"name": place.name, "n_bytes": n_bytes}


async def _next_of(chunks: AsyncIterator[bytes]) -> bytes | None:
    async with asyncio.timeout(_STALLED_S):
        return await anext(chunks, None)


def _sweep(folder: Path) -> None:
    for path in folder.glob(f"{COMING}*"):
        with contextlib.suppress(OSError):
            if time.time() - path.lstat().st_mtime > _LEFT_S:
                path.unlink()


class _ComingFile:
    """A file that is not whole yet, under another name beside its place. Used in threads."""

    def __init__(self, place: Path, *, replace: bool) -> None:
        if place.exists() and not replace:
            raise FaceError("exists", f"{shown(place.name)}: is there already")
        _sweep(place.parent)
        self._place = place
        self._replace = replace
        # A write goes on in its thread when its client is given up.
        self._lock = threading.Lock()
        fd, coming = tempfile.mkstemp(place.suffix, COMING, place.parent)
        self._path = Path(coming)
        self._file = os.fdopen(fd, "wb")

    def write(self, chunk: bytes) -> None:
        with self._lock:
            self._file.write(chunk)

    def finish(self) -> None:
        """On the disk, known to be sound, and at its place."""
        with self._lock:
            self._file.flush()
            os.fsync(self._file.fileno())
            check_sound(self._path, self._place.name)
            self._path.chmod(0o644)
            if self._replace:
                self._path.replace(self._place)
                return
            try:
                # Unlike a rename, this never takes another file's place.
                os.link(self._path, self._place)
            except FileExistsError as error:
                raise FaceError("exists", f"{shown(self._place.name)}: is there already") from error

    def close(self) -> None:
        """Nothing is left under the other name."""
        with self._lock:
            try:
                self._file.close()
            finally:
                self._path.unlink(missing_ok=True)
