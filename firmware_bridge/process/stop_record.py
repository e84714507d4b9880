"""The file in which a stop by a person is kept for the face's next process.

A thread writes the newest state, and until it has, the supervisor's memory holds the stop. Only a
power cut in between could lose it; so after a run that a power cut ended, which its record shows by
another boot of the computer, the face starts limp as well.

A record has one length and is rewritten in place: a full disk has room for what is there already.
Only a power cut can end such a write in its middle, and its record is then the old one, the new
one, or cannot be read; with the last of these the face starts limp as well.
"""

import contextlib
import errno
import json
import logging
import os
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from firmware_bridge.stopping import StopLevel, StopRequest

_LOG: Final = logging.getLogger(__name__)
_CUT_OFF: Final = (
    "the power was cut in the run before this one, and a stop may have been lost; "
    "`start_after_power_cut: true` in the face's YAML drives it all the same"
)
#: A block of most disks.
_RECORD_BYTES: Final = 4096
#: Whatever its characters, a name of so many fits into a record.
_LONGEST_NAME: Final = 200
#: A record that could not be written is tried again so often: the disk may have room again.
_RETRY_S: Final = 5.0
#: The last write of a process may take so long; the servos are limp by then.
_LAST_WRITE_S: Final = 5.0


class StopRecord:
    """The file that records a person's stop of one face; only `problem_after` and `close` wait.

    stopped: the stop of an earlier process that is still in force; None: the face may be driven.
    why: the reason of that stop in one line, for a log. problem: why the disk has not kept the
    state that was written last, in one line; empty: it has.
    """

    def __init__(
        self,
        path: Path | None = None,
        *,
        started_by_person: bool = False,
        drives_after_power_cut: bool = False,
        on_change: Callable[[StopRequest | None], None] = lambda _stop: None,
    ) -> None:
        """Read the record of an earlier process at `path`; write there that a process runs now.

        Parameters
        ----------
        path : path of the file; None: no record is kept.
        started_by_person : whether this very start is a person's, so that no earlier stop holds.
        drives_after_power_cut : whether a face is driven at once after a power cut.
        on_change : receives every stop, and None when a person has started the face again.

        """
        self._path = path
        self._on_change = on_change
        self._boot = _boot_id()
        self.stopped: StopRequest | None = None
        self.why = ""
        before = {} if path is None else _read(path)
        if not started_by_person:
            self.stopped, self.why = self._left_by(before, drives_after_power_cut)
        self.problem = ""
        self._is_due = threading.Condition()
        self._state: dict[str, Any] = {}
        self._tried = self._state
        if path is not None:
            self._keep(is_running=True)
            threading.Thread(
                target=self._write_all, args=(path,), name="stop record", daemon=True
            ).start()

    def stop(self, request: StopRequest | None) -> None:
        """Record that a person stopped the face; None: a person started it again."""
        self.stopped = request
        self._keep(is_running=True)
        self._on_change(request)

    def problem_after(self, timeout_s: float) -> str:
        """Wait until the newest state has been written; return why it is not kept, empty: it is.

        Waits `timeout_s` at most; a disk that has not finished by then is a reason as well.
        """
        with self._is_due:
            if self._is_due.wait_for(lambda: self._tried is self._state, timeout_s):
                return self.problem
        return _not_kept(self._path, f"the disk has not written it within {timeout_s:g} s")

    def close(self) -> None:
        """Record that this process ended in order, and wait for the write, 5 s at most."""
        self._keep(is_running=False)
        self.problem_after(_LAST_WRITE_S)

    def _left_by(
        self, before: dict[str, Any], drives_after_power_cut: bool
    ) -> tuple[StopRequest | None, str]:
        """Return (stop, why) that an earlier process's record leaves in force; (None, ""): no stop.

        before: the record's content. A face starts limp, whatever the level of the stop was, after
        a person's stop, an unreadable record, or a power cut unless `drives_after_power_cut`.
        """
        if before.get("error"):
            return StopRequest(StopLevel.LIMP, "a record that cannot be read"), before["error"]
        if before.get("stopped"):
            by = str(before.get("stopped_by") or "a person")
            why = f"{by} stopped it, {before.get('at', 'some time ago')}"
            return StopRequest(StopLevel.LIMP, by), why
        was_cut_off = before.get("is_running") and before.get("boot") != self._boot
        if was_cut_off and not drives_after_power_cut:
            return StopRequest(StopLevel.LIMP, "a power cut"), _CUT_OFF
        return None, ""

    def _keep(self, *, is_running: bool) -> None:
        """Hand the present state to the writing thread; is_running: False at this process's end."""
        if self._path is None:
            return
        stop = self.stopped
        with self._is_due:
            self._state = {
                "version": 1,
                "is_running": is_running,
                "boot": self._boot,
                "stopped": None if stop is None else stop.level.value,
                "stopped_by": None if stop is None else stop.requested_by[:_LONGEST_NAME],
                "at": time.strftime("%Y-%m-%d %H:%M:%S"),
            }
            self._is_due.notify_all()

    def _write_all(self, path: Path) -> None:
        """Write every new state to `path` until the process ends; run by the thread.

        A state that could not be written is tried again every 5 s.
        """
        while True:
            with self._is_due:
                if self._tried is self._state:
                    self._is_due.wait(_RETRY_S if self.problem else None)
                state = self._state
            problem = _problem_of_writing(path, json.dumps(state).encode())
            if problem and problem != self.problem:
                _LOG.warning("%s", problem)
            with self._is_due:
                self.problem, self._tried = problem, state
                self._is_due.notify_all()
            if not state["is_running"]:
                return


def _boot_id() -> str:
    try:
        return Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    except OSError:
        return ""


def _read(path: Path) -> dict[str, Any]:
    """Return the record's content; {}: no file; {"error": line}: it is unreadable or no record."""
    try:
        with path.open("rb") as file:
            state = json.loads(file.read(_RECORD_BYTES))
        if isinstance(state, dict):
            return state
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        return {"error": f"{path}: cannot be read: {error}"}
    return {"error": f"{path}: is no record of a stop; remove it"}


def _not_kept(path: Path | None, why: object) -> str:
    return f"{path}: a stop or start cannot be kept for a restart: {why}"


def _problem_of_writing(path: Path, record: bytes) -> str:
    """Write `record` to the file `path`; return why that failed, in one line, "" if it did not.

    In place if possible, which needs no room on the disk; else to a new file that replaces it.
    Blocks until the disk has it.
    """
    try:
        with contextlib.suppress(OSError):
            _write(path, record, os.O_WRONLY)
            return ""
        path.parent.mkdir(parents=True, exist_ok=True)
        coming = path.with_name(f".{path.name}.{os.getpid()}")
        try:
            _write(coming, record, os.O_WRONLY | os.O_CREAT)
            coming.replace(path)
            _wait_for_disk(path.parent)
        finally:
            coming.unlink(missing_ok=True)
    except OSError as error:
        return _not_kept(path, error.strerror or error)
    return ""


def _wait_for_disk(folder: Path) -> None:
    fd = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(fd)
    finally:
        os.close(fd)


def _write(path: Path, record: bytes, flags: int) -> None:
    """Write `record`, filled up with spaces, to the beginning of a file, and wait for the disk.

    Raises OSError.
    """
    fd = os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)
    try:
        if os.pwrite(fd, record.ljust(_RECORD_BYTES), 0) < len(record):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        os.fdatasync(fd)
    finally:
        os.close(fd)
