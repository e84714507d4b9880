"""Tracks: the motion of a talking person's head, eyes and lids, with the sound.

Tracks of a user's own: `NAME.csv` beside `NAME.wav` or any other sound file.

A CSV file has a header and a row a moment: `time_s` and columns named as in `Expression`: the three
of the neck at least; the two of the eyes, the two lids where they were tracked.
"""

import csv
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from lipservo_lab.learning.learned_expression.expression_model import RATE_HZ
from lipservo_lab.learning.learned_expression.learned_expression import prosody_of
from lipsync.arrays import Array
from lipsync.audio.file import read_speech
from lipsync.audio_block import BLOCK_S, SAMPLE_RATE_HZ
from lipsync.errors import UserError
from lipsync.face.frame import Expression
from lipsync.prosody.voice_tracker import VoiceTracker

NAMES = tuple(each.name for each in fields(Expression))
HEAD = ("neck_pitch_deg", "neck_yaw_deg", "neck_roll_deg")
GAZE = ("eye_yaw_deg", "eye_pitch_deg")
LIDS = ("lid_left", "lid_right")
#: Half a second: shorter tracks hold no motion.
LEAST_FRAMES = round(0.5 * RATE_HZ)
_BLOCK = round(BLOCK_S * SAMPLE_RATE_HZ)
_BLOCKS_PER_FRAME = round(1.0 / (RATE_HZ * BLOCK_S))

#: What is done, how many, of how many.
Progress = Callable[[str, int, int], None]


def no_progress(_what: str, _n_done: int, _n_all: int) -> None:
    """Progress that is not shown."""


class TrackError(UserError):
    """Tracks that cannot be read, or teach nothing; one line: which file, what, what to do."""


@dataclass(frozen=True, slots=True)
class ExpressionTrack:
    """One recording. values: (n_frames,) by a name of `Expression`; frame i is at i / 25 s."""

    name: str
    values: dict[str, Array]
    sound_path: Path

    @property
    def n_frames(self) -> int:
        """How many frames it has."""
        return len(next(iter(self.values.values())))

    def stacked(self, names: Sequence[str]) -> Array:
        """Return the values of some names.

        Parameters
        ----------
        names : Sequence[str]
            n of them.

        Returns
        -------
        Array
            (n_frames, n).
        """
        return np.stack([self.values[name] for name in names], axis=1)


@dataclass(frozen=True, slots=True)
class HeardTrack:
    """A track and what was heard: prosody (n_frames, 2), pitch and loudness z until each frame."""

    track: ExpressionTrack
    prosody: Array


def at_model_rate(times_s: Array, values: dict[str, Array]) -> dict[str, Array]:
    """Return values at 25 Hz from 0 s to the last time, interpolated; before the first, held.

    Parameters
    ----------
    times_s : Array
        (n,).
    values : dict[str, Array]
        (n,) by name.

    Returns
    -------
    dict[str, Array]
        (n_frames,) by name.
    """
    frames_s = np.arange(int(times_s[-1] * RATE_HZ + 1e-6) + 1) / RATE_HZ
    return {name: np.interp(frames_s, times_s, each) for name, each in values.items()}


def hear(tracks: Sequence[ExpressionTrack], progress: Progress = no_progress) -> list[HeardTrack]:
    """The tracks with their prosody, as the live part measures it; one voice speaks them all.

    The same tracker gets one after the other, so that the voice is known from the second on.
    Raises SoundError.
    """
    tracker, heard = VoiceTracker(), []
    for number, track in enumerate(tracks, start=1):
        samples = read_speech(track.sound_path)
        heard.append(HeardTrack(track, prosody_frames(samples, track.n_frames, tracker)))
        progress("hearing", number, len(tracks))
    return heard


def prosody_frames(samples: np.ndarray, n_frames: int, tracker: VoiceTracker) -> Array:
    """Return pitch and loudness z, means over the 40 ms before each frame.

    Sound that ends before the track is silence. Frame 0 has heard nothing yet.

    Parameters
    ----------
    samples : np.ndarray
        (n,) at 16 kHz.
    n_frames : int
        At 25 Hz.
    tracker : VoiceTracker
        Knows the voice.

    Returns
    -------
    Array
        (n_frames, 2).
    """
    n_blocks = (n_frames - 1) * _BLOCKS_PER_FRAME
    whole = np.zeros(n_blocks * _BLOCK, np.float32)
    n_heard = min(len(whole), len(samples))
    whole[:n_heard] = samples[:n_heard]
    blocks = whole.reshape(-1, _BLOCK)
    each = np.array([prosody_of(tracker.feed(block)) for block in blocks]).reshape(-1, 2)
    frames = each.reshape(-1, _BLOCKS_PER_FRAME, 2).mean(axis=1)
    return np.concatenate((frames[:1], frames))


def check_alike(tracks: Iterable[ExpressionTrack]) -> None:
    """Raises TrackError where tracks tell of different things: one model is made of all."""
    first: ExpressionTrack | None = None
    for track in tracks:
        first = first or track
        if set(track.values) != set(first.values):
            differ = ", ".join(sorted(set(track.values) ^ set(first.values)))
            raise TrackError(
                f"{track.name} and {first.name} differ in {differ}; give all the same columns"
            )


_SOUNDS = (".wav", ".flac", ".ogg", ".opus", ".mp3", ".aiff", ".aif")
#: Longer holes are not interpolated.
_LONGEST_HOLE_S = 0.5
_MOST_DEG = 90.0


def read_track_files(folder: Path, progress: Progress = no_progress) -> list[ExpressionTrack]:
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
