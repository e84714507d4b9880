"""Trace files, JSON lines: a header, a line for every tick of the motion loop, a last line.

The file gets its name when it is complete; until then it is `NAME.partial`. It contains no
wall-clock time, so that two replays of one file give the same bytes. A file that is read may be
whole or cut short, plain or `.gz`.
"""

import gzip
import json
import logging
import math
import queue
import threading
import time
import zlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Final

import numpy as np

from lipservo.runtime.status.street_tick import StreetTick
from lipsync.arrays import Array
from lipsync.errors import UserError
from lipsync.output_file import OutputError, check_output, written_whole

_LOG: Final = logging.getLogger(__name__)
TRACE_VERSION = 1
#: The first key of every trace.
_VERSION_KEY = "lipservo_trace"
#: Ticks that may wait for the disk: a minute at 200 Hz.
_QUEUE_LENGTH = 12_000
#: While the end of a trace waits for the disk, its face sends a heartbeat so often, for so long.
_BEAT_S, _BEATS_S = 0.05, 10.0
#: More than a day at 200 Hz, unpacked; a small file may unpack to any size.
_MOST_BYTES = 8_000_000_000


class TraceError(UserError):
    """A trace that could not be written to its end, or cannot be read."""


def is_trace(head: bytes) -> bool:
    """Return whether a file with these first bytes is a trace."""
    return head.startswith(f'{{"{_VERSION_KEY}":'.encode())


class TraceFile:
    """A trace file, record of a run, to which each tick (step of the motion loop) is written.

    `observe` may block on the disk, which a replay may wait for; the live loop uses
    `BackgroundTrace`.
    """

    def __init__(self, path: Path, header: Mapping[str, object]) -> None:
        """Open the file and write `header`, what a reader needs first, such as the servo names.

        Raises OutputError if it cannot be written; only a trace is overwritten.
        """
        check_output(path, replaces=is_trace, kind="trace")
        self._path = path
        self._open_files = ExitStack()
        partial = self._open_files.enter_context(written_whole(path))
        self._file = self._open_files.enter_context(partial.open("w", encoding="utf-8"))
        self._n_ticks = 0
        self._write({_VERSION_KEY: TRACE_VERSION, **header})

    def observe(self, tick: StreetTick) -> None:
        """Write the record of one tick, a step of the motion loop.

        Raises TraceError if the disk is full, and then leaves no file.
        """
        self._write(_tick_record(self._n_ticks, tick))
        self._n_ticks += 1

    def close(self, dropped: int = 0) -> None:
        """Complete the file and give it its name. dropped: number of ticks that were not written.

        Raises OutputError if that fails; does nothing to a closed or abandoned file.
        """
        if self._file.closed:
            return
        with self._open_files:
            self._write({"ticks": self._n_ticks, "dropped": dropped})

    def abandon(self) -> None:
        """Remove the unfinished file; for one that cannot be completed."""
        # An exception in its block makes `written_whole` delete the unfinished file.
        with suppress(OutputError), self._open_files:
            raise OutputError("the trace was abandoned")

    def __enter__(self) -> "TraceFile":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def _write(self, record: Mapping[str, object]) -> None:
        try:
            self._file.write(json.dumps(record, separators=(",", ":")) + "\n")
        except OSError as error:
            self.abandon()
            raise TraceError(f"{self._path}: the trace stopped: {error.strerror}") from error


class BackgroundTrace:
    """A trace file written by a thread, so that the live loop never waits for the disk.

    When the disk is a minute late, ticks are dropped, and the last line has their number.
    """

    def __init__(self, file: TraceFile, beat: Callable[[], None] = lambda: None) -> None:
        """Start the thread; an error in writing is logged, and raised when the block ends.

        beat: called for 10 s at most while the end of the block waits for the disk.
        """
        self._file = file
        self._beat = beat
        self._queue: queue.SimpleQueue[StreetTick | None] = queue.SimpleQueue()
        self._error: UserError | None = None
        self._dropped = 0
        self._thread = threading.Thread(target=self._write_queued, name="trace", daemon=True)
        self._thread.start()

    def observe(self, tick: StreetTick) -> None:
        """Queue the record of one tick, a step of the motion loop, to be written.

        It is dropped and counted if the queue is full.
        """
        if self._queue.qsize() < _QUEUE_LENGTH:
            self._queue.put(tick)
        else:
            self._dropped += 1

    def __enter__(self) -> "BackgroundTrace":
        return self

    def __exit__(self, *exc: object) -> None:
        self._queue.put(None)
        give_up_s = time.monotonic() + _BEATS_S
        while self._thread.is_alive():
            if time.monotonic() < give_up_s:
                self._beat()
            self._thread.join(_BEAT_S)
        if self._error is not None:
            raise self._error

    def _write_queued(self) -> None:
        """Write queued ticks until the block ends, and end the file. Runs in thread `trace`.

        After a write fails all further ticks are dropped; the face goes on.
        """
        while (tick := self._queue.get()) is not None:
            try:
                if self._error is None:
                    self._file.observe(tick)
            except TraceError as error:  # a full disk must not stop the face
                self._error = error
                _LOG.error("%s; the face goes on", error)
        try:
            if self._error is None:
                self._file.close(self._dropped)
        except UserError as error:
            self._error = error


def _tick_record(number: int, tick: StreetTick) -> dict[str, object]:
    """Return a tick's record in a trace, for JSON. number: of the tick, from 0.

    `range_hits` and `rate_hits` are the indices of servos whose goal was clamped to its range, or
    slowed to its speed and acceleration.
    """
    report = tick.report
    return {
        "tick": number,
        "sound_s": round(tick.sound_s, 6),
        "phoneme": tick.phoneme,
        "hears": tick.hearing,
        "moved_by": tick.moved_by,
        "coefficients": _rounded(tick.coefficients.tolist()),
        "wanted_deg": _rounded(report.wanted_deg.tolist()),
        "sent_deg": _rounded(report.sent_deg.tolist()),
        "late": report.late,
        # JSON knows no infinity: None before the first target.
        "target_age_s": round(age_s, 6) if math.isfinite(age_s := report.target_age_s) else None,
        "stale": report.stale.name.lower(),
        "torque_on": report.torque_on,
        "range_hits": report.range_hits.nonzero()[0].tolist(),
        "rate_hits": report.rate_hits.nonzero()[0].tolist(),
    }


def _rounded(values: Sequence[float]) -> list[float]:
    return [round(value, 4) for value in values]


@dataclass(frozen=True, slots=True)
class Trace:
    """The motion of one recorded run at its n ticks, steps of the motion loop, in order of time.

    face: the face's name; model: checksum of the face model; delay_s: of the motion behind the
    arrival of sound. sound_s: (n,), sound time of the frame at each tick; coefficients: (n,
    n_components); sent_deg: (n, n_servos). notes: cautions, such as that the file was cut short.
    complete: whether it has its last line.
    """

    name: str
    face: str
    servos: tuple[str, ...]
    model: str
    delay_s: float
    sound_s: Array
    phonemes: tuple[str, ...]
    coefficients: Array
    sent_deg: Array
    complete: bool
    notes: tuple[str, ...]


def read_trace(path: Path) -> Trace:
    """Read a trace file. Raises TraceError with one line if it is no trace or is damaged."""
    lines = _read_lines(path)
    header = _parse_record(lines[0]) if lines else None
    if header is None or header.get("lipservo_trace") != TRACE_VERSION:
        raise TraceError(f"{path}: not a lipservo trace of version {TRACE_VERSION}")
    ticks: list[Mapping[str, Any]] = []
    end: Mapping[str, Any] | None = None
    is_torn = False
    for number, line in enumerate(lines[1:], start=2):
        record = _parse_record(line)
        # Only the last line may be cut off or unreadable: the run ended while it was written.
        if record is None or end is not None:
            if number < len(lines):
                raise TraceError(f"{path}: damaged in line {number}")
            is_torn = True
        elif "ticks" in record:
            end = record
        else:
            ticks.append(record)
    try:
        return _make_trace(path, header, ticks, end, torn=is_torn)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise TraceError(f"{path}: damaged: {error or 'no ticks'}") from error


def _make_trace(
    path: Path,
    head: Mapping[str, Any],
    ticks: list[Mapping[str, Any]],
    end: Mapping[str, Any] | None,
    *,
    torn: bool,
) -> Trace:
    """Return the trace made of a file's parsed lines.

    head: the first line; end: the last one, None: cut short; torn: a line is incomplete. Raises
    TraceError for fewer than two ticks; KeyError, TypeError or ValueError for damaged lines.
    """
    if len(ticks) < 2:
        raise TraceError(f"{path}: has only {len(ticks)} ticks; two are needed")
    notes = []
    if end is None:
        where = ", its last line torn" if torn else ""
        notes.append(f"{path.name} was cut short after {len(ticks)} ticks{where}")
    elif end["dropped"]:
        notes.append(f"{path.name} lacks {end['dropped']} ticks, for the disk was too slow")
    servos = tuple(str(name) for name in head["servos"])
    if not servos:
        raise ValueError("it names no servo")
    trace = Trace(
        name=path.name,
        face=str(head["face"]),
        servos=servos,
        model=str(head["model"]),
        delay_s=float(head["delay_s"]),
        sound_s=np.array([tick["sound_s"] for tick in ticks], dtype=np.float64),
        phonemes=tuple(str(tick["phoneme"]) for tick in ticks),
        coefficients=np.array([tick["coefficients"] for tick in ticks], dtype=np.float64),
        sent_deg=np.array([tick["sent_deg"] for tick in ticks], dtype=np.float64),
        complete=end is not None,
        notes=tuple(notes),
    )
    if trace.sent_deg.shape != (len(ticks), len(servos)) or trace.coefficients.ndim != 2:
        raise ValueError("its rows differ in length")
    if not (np.diff(trace.sound_s) > 0.0).all():
        raise ValueError("its times do not increase")
    if not (np.isfinite(trace.sent_deg).all() and np.isfinite(trace.coefficients).all()):
        raise ValueError("it has values that are not finite")
    return trace


def _read_lines(path: Path) -> list[bytes]:
    """Return the file's non-empty lines, unpacked; of a packed file cut short, those that remain.

    At most 8 GB are unpacked. Raises TraceError.
    """
    try:
        raw = path.read_bytes()
        if not raw.startswith(b"\x1f\x8b"):
            return [line for line in raw.split(b"\n") if line]
        unpacked = bytearray()
        with gzip.open(path) as file, suppress(EOFError):
            while len(unpacked) < _MOST_BYTES and (chunk := file.read1(1 << 20)):
                unpacked += chunk
    except OSError as error:
        raise TraceError(f"{path}: cannot be read: {error.strerror or error}") from error
    except zlib.error as error:
        raise TraceError(f"{path}: damaged: {error}") from error
    return [line for line in bytes(unpacked).split(b"\n") if line]


def _parse_record(line: bytes) -> Mapping[str, Any] | None:
    try:
        record = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return record if isinstance(record, dict) else None
