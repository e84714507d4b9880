"""Tracks of a user's own: `NAME.csv` beside `NAME.wav` or any other sound file.

A CSV file has a header and a row a moment: `time_s` and columns named as in `Expression`: the three
of the neck at least; the two of the eyes, the two lids where they were tracked.
"""

import csv
from pathlib import Path

import numpy as np

from lipservo_lab.learning.expression.tracks import (
    GAZE,
    HEAD,
    LEAST_FRAMES,
    LIDS,
    NAMES,
    ExpressionTrack,
    Progress,
    TrackError,
    at_model_rate,
    nobody_watches,
)
from lipsync.arrays import Array

_SOUNDS = (".wav", ".flac", ".ogg", ".opus", ".mp3", ".aiff", ".aif")
#: Longer holes are not interpolated.
_LONGEST_HOLE_S = 0.5
_MOST_DEG = 90.0


def read_track_files(folder: Path, progress: Progress = nobody_watches) -> list[ExpressionTrack]:
    """All tracks of a folder, by name. Raises TrackError."""
    if not folder.is_dir():
        raise TrackError(f"{folder}: no such folder")
    paths = sorted(folder.glob("*.csv"))
    if not paths:
        raise TrackError(f"{folder}: no NAME.csv; docs/expression-voice.md says what is read")
    tracks = []
    for number, path in enumerate(paths, start=1):
        tracks.append(read_track_file(path))
        progress("reading", number, len(paths))
    return tracks


def read_track_file(path: Path) -> ExpressionTrack:
    """The track of a CSV file and the sound beside it. Raises TrackError."""
    sounds = [path.with_suffix(end) for end in _SOUNDS if path.with_suffix(end).is_file()]
    if not sounds:
        raise TrackError(f"{path}: no sound beside it; put {path.stem}.wav or .flac there")
    columns = _read_columns(path)
    times_s = columns.pop("time_s")
    steps_s = np.diff(times_s)
    if times_s[0] < 0.0 or (steps_s <= 0.0).any():
        raise TrackError(f"{path}: time_s does not grow from 0 on; sort the rows")
    if steps_s.max() > _LONGEST_HOLE_S:
        at_s = times_s[steps_s.argmax()]
        raise TrackError(f"{path}: nothing for {steps_s.max():.2f} s after {at_s:.2f} s; cut it")
    values = at_model_rate(times_s, columns)
    if len(values[HEAD[0]]) < LEAST_FRAMES:
        raise TrackError(f"{path}: shorter than half a second")
    return ExpressionTrack(path.stem, values, sounds[0])


def _read_columns(path: Path) -> dict[str, Array]:
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = list(csv.reader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise TrackError(f"{path}: cannot be read as CSV: {error}") from error
    header = [name.strip() for name in rows[0]] if rows else []
    _check_header(path, header)
    if len(rows) < 3:
        raise TrackError(f"{path}: fewer than two rows of numbers")
    for line, row in enumerate(rows[1:], start=2):
        if len(row) != len(header):
            raise TrackError(f"{path}: line {line} has {len(row)} fields, the header {len(header)}")
    numbers = np.empty((len(rows) - 1, len(header)))
    for index, row in enumerate(rows[1:]):
        for place, text in enumerate(row):
            numbers[index, place] = _number(path, index + 2, header[place], text)
    return dict(zip(header, np.ascontiguousarray(numbers.T), strict=True))


def _check_header(path: Path, header: list[str]) -> None:
    unknown = sorted(set(header) - {"time_s", *NAMES})
    if unknown:
        raise TrackError(f"{path}: no such column: {unknown[0]}; known: time_s, {', '.join(NAMES)}")
    if len(set(header)) != len(header):
        raise TrackError(f"{path}: a column is there twice")
    missing = [name for name in ("time_s", *HEAD) if name not in header]
    for pair in (GAZE, LIDS):
        if 0 < len(set(pair) & set(header)) < 2:
            missing += [name for name in pair if name not in header]
    if missing:
        raise TrackError(f"{path}: lacks the column {', '.join(missing)}")


def _number(path: Path, line: int, name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise TrackError(f"{path}: line {line}, {name}: {text!r} is no number")
    if name.endswith("_deg") and abs(value) > _MOST_DEG:
        raise TrackError(f"{path}: line {line}, {name}: {value:g} degrees, not a head or an eye")
    return value
