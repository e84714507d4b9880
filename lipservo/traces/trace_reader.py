"""Reads the traces that `trace_writer` writes; whole or cut short, plain or `.gz`."""

import gzip
import json
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lipservo.traces.trace_writer import TRACE_VERSION, TraceError
from lipsync.arrays import Array

#: More than a day at 200 Hz, unpacked; a small file may unpack to any size.
_MOST_BYTES = 8_000_000_000


@dataclass(frozen=True, slots=True)
class Trace:
    """The motion of one run, tick by tick, n ticks in order of time.

    sound_s: (n,), the sound time that each tick shows; coefficients: (n, n_components);
    sent_deg: (n, n_servos); model: checksum of the face model. notes: what a reader should know,
    such as that it was cut short. complete: it has its last line.
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
    """The trace in a file. Raises TraceError, one line, for what is none."""
    lines = _lines(path)
    head = _record(lines[0]) if lines else None
    if head is None or head.get("lipservo_trace") != TRACE_VERSION:
        raise TraceError(f"{path}: not a lipservo trace of version {TRACE_VERSION}")
    ticks: list[Mapping[str, Any]] = []
    end: Mapping[str, Any] | None = None
    torn = False
    for number, line in enumerate(lines[1:], start=2):
        record = _record(line)
        if record is None or end is not None:
            if number < len(lines):
                raise TraceError(f"{path}: line {number} is damaged")
            torn = True
        elif "ticks" in record:
            end = record
        else:
            ticks.append(record)
    try:
        return _trace(path, head, ticks, end, torn=torn)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise TraceError(f"{path}: damaged: {error or 'no ticks'}") from error


def _trace(
    path: Path,
    head: Mapping[str, Any],
    ticks: list[Mapping[str, Any]],
    end: Mapping[str, Any] | None,
    *,
    torn: bool,
) -> Trace:
    if len(ticks) < 2:
        raise TraceError(f"{path}: holds {len(ticks)} ticks; nothing to compare")
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
        raise ValueError("rows of different lengths")
    if not (np.diff(trace.sound_s) > 0.0).all():
        raise ValueError("time runs backwards")
    if not (np.isfinite(trace.sent_deg).all() and np.isfinite(trace.coefficients).all()):
        raise ValueError("values that are no numbers")
    return trace


def _lines(path: Path) -> list[bytes]:
    """Without empty ones; what is left of a packed file that was cut short counts."""
    try:
        if path.suffix != ".gz":
            return [line for line in path.read_bytes().split(b"\n") if line]
        unpacked = bytearray()
        with gzip.open(path) as file:
            try:
                while len(unpacked) < _MOST_BYTES and (chunk := file.read1(1 << 20)):
                    unpacked += chunk
            except EOFError:
                pass
    except OSError as error:
        raise TraceError(f"{path}: cannot be read: {error.strerror or error}") from error
    except zlib.error as error:
        raise TraceError(f"{path}: damaged: {error}") from error
    return [line for line in bytes(unpacked).split(b"\n") if line]


def _record(line: bytes) -> Mapping[str, Any] | None:
    try:
        record = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return record if isinstance(record, dict) else None
