"""The health log of servos on disk: a JSON line every ten seconds, a file a UTC day, bounded.

The loop that runs a face calls `offer`; a thread writes. Whatever the disk does, `offer` returns at
once and the face goes on. `lipservo health` reads the files (`health_history`). The folder is that
of the user's or the service's state, where a person's stop is kept too.
"""

import contextlib
import errno
import json
import logging
import math
import os
import queue
import re
import stat
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from firmware_bridge.bus import ServoHealth
from firmware_bridge.port_names import ports_in

_LOG: Final = logging.getLogger(__name__)
#: What the shipped unit gives the service (`StateDirectory=lipservo`); its group may read it.
SERVICE_STATE = Path("/var/lib/lipservo")
#: A month run through for 20 hours a day: ten servos make about 5 MB a day (`LifeCycle` reads
#: every ten seconds). Then the oldest days go.
MOST_DAYS, MOST_BYTES = 30, 100_000_000
#: Readings that may wait for the disk: more than a minute.
_QUEUE_LENGTH = 8
#: How long the end of a run waits for a disk that does not answer.
_CLOSE_S = 1.0
DAY_FILE = re.compile(r"\d{4}-\d\d-\d\d\.jsonl")


def log_folder(face: str, port: str, environment: Mapping[str, str]) -> Path | None:
    """Return the folder for the readings of a face at a port; None: the user has no state folder.

    environment: the process's environment variables. A pseudo-terminal leads to simulated servos:
    these have a folder of their own, or a rehearsal would spoil the figures of the real ones.
    """
    state = _state_folder(environment)
    return None if state is None else state / "health" / _folder_name_at(face, port)


def stop_record_path(face: str, port: str, environment: Mapping[str, str]) -> Path | None:
    """Return the file that keeps a person's stop of a face at a port; None: no state folder."""
    state = _state_folder(environment)
    return None if state is None else state / "stops" / f"{_folder_name_at(face, port)}.json"


def kept_pulses_path(face: str, port: str, environment: Mapping[str, str]) -> Path | None:
    """Return the file with the last pulses of a face of hobby servos; None: no state folder."""
    state = _state_folder(environment)
    return None if state is None else state / "pulses" / f"{_folder_name_at(face, port)}.json"


def _folder_name_at(face: str, port: str) -> str:
    simulated = any(os.path.realpath(each).startswith("/dev/pts/") for each in ports_in(port))
    return folder_name(face) + ("-simulated" if simulated else "")


def folder_name(face: str) -> str:
    """Return a face's name as a folder: lower-case words, dashes between, 60 characters at most."""
    return re.sub(r"\W+", "-", face.lower())[:60].strip("-") or "face"


def logged_faces(environment: Mapping[str, str]) -> dict[str, list[Path]]:
    """Return the log folders of every face, by folder name: the user's own and the service's."""
    folders_of_face: dict[str, list[Path]] = {}
    for place in _health_folders(environment):
        try:
            folders = sorted(each for each in place.iterdir() if each.is_dir())
        except OSError:
            continue
        for folder in folders:
            folders_of_face.setdefault(folder.name, []).append(folder)
    return folders_of_face


def places_searched(environment: Mapping[str, str]) -> str:
    """Return the folders in which logs are searched, for the message that no log was found."""
    return " and ".join(
        f"{each}" if _may_read(each) else f"{each} (only its group and root may read it)"
        for each in _health_folders(environment)
    )


def _may_read(folder: Path) -> bool:
    try:
        os.listdir(folder)
    except PermissionError:
        return False
    except OSError:  # it is not there
        return True
    return True


def _health_folders(environment: Mapping[str, str]) -> list[Path]:
    own = _state_folder(environment)
    places = [own] if environment.get("LIPSERVO_STATE") else [own, SERVICE_STATE]
    return [each / "health" for each in places if each is not None]


def _state_folder(environment: Mapping[str, str]) -> Path | None:
    """Return the folder of this user's state; None if no variable names one.

    The first of $LIPSERVO_STATE, $XDG_STATE_HOME/lipservo and $HOME/.local/state/lipservo.
    https://specifications.freedesktop.org/basedir-spec/latest/ : a relative path is ignored.
    """
    folder = environment.get("LIPSERVO_STATE")
    if folder:
        return Path(folder)
    state = environment.get("XDG_STATE_HOME", "")
    if os.path.isabs(state):
        return Path(state) / "lipservo"
    home = environment.get("HOME", "")
    return Path(home) / ".local/state/lipservo" if os.path.isabs(home) else None


class HealthLog:
    """A log that appends the servo readings of one face to files in a folder, in a thread."""

    def __init__(self, folder: Path, wall_s: Callable[[], float] = time.time) -> None:
        """Start the thread that writes to `folder`. wall_s: returns seconds since 1970."""
        self._folder = folder
        self._wall_s = wall_s
        self._number = 0
        self._complained = False
        self._queue: queue.Queue[tuple[float, tuple[ServoHealth, ...]] | None]
        self._queue = queue.Queue(_QUEUE_LENGTH)
        self._thread = threading.Thread(target=self._write_queued, name="health log", daemon=True)
        self._thread.start()

    def offer(self, now: tuple[ServoHealth, ...]) -> None:
        """Queue one reading of all servos, `now`; drop it when the disk is a minute behind."""
        with contextlib.suppress(queue.Full):
            self._queue.put_nowait((self._wall_s(), now))

    def close(self) -> None:
        """Write the queued readings and end the thread; wait at most about two seconds."""
        try:
            self._queue.put(None, timeout=_CLOSE_S)
        except queue.Full:
            return
        self._thread.join(_CLOSE_S)

    def __enter__(self) -> "HealthLog":
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()

    def _write_queued(self) -> None:
        """Write queued readings until the log is closed. Runs in thread `health log`.

        A reading that cannot be written is lost; only the first such error is logged.
        """
        while (offered := self._queue.get()) is not None:
            try:
                self._append(*offered)
            except OSError as error:
                if not self._complained:
                    self._complained = True
                    why = error.strerror or error
                    complaint = "the health log %s cannot be written: %s; the face goes on"
                    _LOG.error(complaint, self._folder, why)

    def _append(self, wall_s: float, servos: Sequence[ServoHealth]) -> None:
        """Append one reading of all servos to the file of its UTC day, and prune old files.

        wall_s: seconds since 1970. Raises OSError.
        """
        time_utc = datetime.fromtimestamp(wall_s, UTC)
        path = self._folder / f"{time_utc:%Y-%m-%d}.jsonl"
        self._folder.mkdir(parents=True, exist_ok=True)
        prune(self._folder, keep=path.name)
        line = json_line(time_utc, self._number, servos)
        _LOG.debug("servos: %s", line.decode())
        append_line(path, line)
        self._number += 1


def health_log(face: str, port: str | None, environment: Mapping[str, str]) -> HealthLog | None:
    """Return the log of a face whose servos are at `port`; None for servos simulated in memory.

    Servos in memory never age, never warm up differently and are run in every rehearsal: readings
    of them would push out real ones. None, with an error logged, also without a state folder.
    """
    if port is None:
        return None
    folder = log_folder(face, port, environment)
    if folder is None:
        _LOG.error("health is not logged: set HOME, XDG_STATE_HOME or LIPSERVO_STATE")
        return None
    return HealthLog(folder)


def json_line(moment: datetime, number: int, servos: Sequence[ServoHealth]) -> bytes:
    """Return one reading of all servos as a line of JSON, with a list for each quantity.

    Values never received are null. number: of the reading in its run; 0 begins a run, in which
    reboots and unanswered requests count from 0.
    """
    record = {
        "time": f"{moment:%Y-%m-%dT%H:%M:%SZ}",
        "number": number,
        "servos": [servo.name for servo in servos],
        "ids": [servo.servo_id for servo in servos],
        "states": [servo.state for servo in servos],
        "temperature_degc": [_number(servo.temperature_degc, 0) for servo in servos],
        "load": [_number(servo.load, 2) for servo in servos],
        "voltage_v": [_number(servo.voltage_v, 1) for servo in servos],
        "current_ma": [_number(servo.current_ma, 0) for servo in servos],
        "errors": [servo.hardware_errors for servo in servos],
        "reboots": [servo.n_reboots for servo in servos],
        "unanswered": [servo.n_unanswered for servo in servos],
        "torque_on": [_number(servo.torque_on, 0) for servo in servos],
    }
    return (json.dumps(record, separators=(",", ":")) + "\n").encode()


def append_line(path: Path, line: bytes) -> None:
    """Append a line by one write, so that programs' lines never mix; end a torn last line first.

    Raises OSError, also when only a part could be written, and for a file over 100 MB.
    """
    # Not blocking: a pipe of this name must not hold anybody up.
    flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_NONBLOCK
    descriptor = os.open(path, flags, 0o644)
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise OSError(errno.EINVAL, f"{path.name} is no plain file")
        size = status.st_size
        if size > MOST_BYTES:
            raise OSError(errno.EFBIG, os.strerror(errno.EFBIG))
        is_torn = size > 0 and os.pread(descriptor, 1, size - 1) != b"\n"
        to_write = b"\n" + line if is_torn else line
        if os.write(descriptor, to_write) != len(to_write):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    finally:
        os.close(descriptor)


def prune(
    folder: Path, keep: str, most_days: int = MOST_DAYS, most_bytes: int = MOST_BYTES
) -> None:
    """Remove the oldest day files beyond the bounds, never the day file `keep`, nor other files.

    Days are counted, not dated: a clock that is wrong for a while costs one day, not all.
    most_days: day files at most, `keep` included. most_bytes: of all of them.
    """
    others = sorted(
        name for name in os.listdir(folder) if DAY_FILE.fullmatch(name) and name != keep
    )
    sizes = {name: (folder / name).stat().st_size for name in others}
    room = most_bytes - ((folder / keep).stat().st_size if (folder / keep).exists() else 0)
    while others and (len(others) >= most_days or sum(sizes.values()) > room):
        oldest = others.pop(0)
        (folder / oldest).unlink(missing_ok=True)
        del sizes[oldest]


def _number(value: float | None, digits: int) -> float | int | None:
    if value is None or not math.isfinite(value):
        return None
    return round(value, digits) if digits else round(value)
