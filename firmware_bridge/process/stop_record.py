"""The file in which a stop by a person is kept for the face's next process.

Nothing waits for the disk: a thread writes the newest state, and until it has, the supervisor's
memory holds the stop. Only a power cut in between could lose it; so after a run that a power cut
ended, which its record shows by another boot of the computer, the face starts limp as well.
"""

import contextlib
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
_BOOT_ID: Final = Path("/proc/sys/kernel/random/boot_id")
_CUT_OFF: Final = (
    "the power was cut in the run before this one, and a stop may have been lost; "
    "`start_after_power_cut: true` in the face's YAML drives it all the same"
)
_LONGEST_BYTES: Final = 4096
#: The last write of a process may take so long; the servos are limp by then.
_LAST_WRITE_S: Final = 5.0


class StopRecord:
    """The file that records a person's stop of one face; all methods but `close` return at once.

    stopped: the stop of an earlier process that is still in force; None: the face may be driven.
    why: the reason of that stop in one line, for a log.
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
        self._is_due = threading.Condition()
        self._state: dict[str, Any] = {}
        self._is_written = True
        if path is not None:
            threading.Thread(target=self._write_all, name="stop record", daemon=True).start()
        self._keep(is_running=True)

    def stop(self, request: StopRequest | None) -> None:
        """Record that a person stopped the face; None: a person started it again."""
        self.stopped = request
        self._keep(is_running=True)
        self._on_change(request)

    def close(self) -> None:
        """Record that this process ended in order, and wait for the write, 5 s at most."""
        self._keep(is_running=False)
        give_up_s = time.monotonic() + _LAST_WRITE_S
        with self._is_due:
            while not self._is_written and (left_s := give_up_s - time.monotonic()) > 0.0:
                self._is_due.wait(left_s)

    def _left_by(
        self, before: dict[str, Any], drives_after_power_cut: bool
    ) -> tuple[StopRequest | None, str]:
        if before.get("error"):
            return StopRequest(StopLevel.LIMP, "a record that cannot be read"), before["error"]
        if before.get("stopped"):
            by = str(before.get("stopped_by") or "a person")
            why = f"{by} stopped it, {before.get('at', 'some time ago')}"
            return StopRequest(StopLevel.LIMP, by), why
        if before.get("is_running") and before.get("boot") != self._boot:
            if drives_after_power_cut:
                return None, ""
            return StopRequest(StopLevel.LIMP, "a power cut"), _CUT_OFF
        return None, ""

    def _keep(self, *, is_running: bool) -> None:
        if self._path is None:
            return
        stop = self.stopped
        with self._is_due:
            self._state = {
                "version": 1,
                "is_running": is_running,
                "boot": self._boot,
                "stopped": None if stop is None else stop.level.value,
                "stopped_by": None if stop is None else stop.requested_by,
                "at": time.strftime("%Y-%m-%d %H:%M:%S"),
            }
            self._is_written = False
            self._is_due.notify_all()

    def _write_all(self) -> None:
        assert self._path is not None
        while True:
            with self._is_due:
                while self._is_written:
                    if not self._state.get("is_running", True):
                        return
                    self._is_due.wait()
                state = self._state
            try:
                _write(self._path, json.dumps(state))
            except OSError as error:
                why = error.strerror or error
                _LOG.warning("%s: a stop cannot be kept for a restart: %s", self._path, why)
            with self._is_due:
                self._is_written = state is self._state
                self._is_due.notify_all()


def _boot_id() -> str:
    try:
        return _BOOT_ID.read_text().strip()
    except OSError:
        return ""


def _read(path: Path) -> dict[str, Any]:
    """Return the record's content; {}: no file; {"error": line}: it is unreadable or no record."""
    try:
        with path.open("rb") as file:
            state = json.loads(file.read(_LONGEST_BYTES))
        if isinstance(state, dict):
            return state
    except FileNotFoundError:
        return {}
    except (OSError, ValueError) as error:
        return {"error": f"{path}: cannot be read: {error}"}
    return {"error": f"{path}: is no record of a stop; remove it"}


def _write(path: Path, text: str) -> None:
    """Write `text` to the file `path`, completely or not at all. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    coming = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        with coming.open("w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        coming.replace(path)
    except OSError:
        with contextlib.suppress(OSError):
            coming.unlink()
        raise
