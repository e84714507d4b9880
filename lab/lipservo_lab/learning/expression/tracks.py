"""Tracks: what a head, its eyes and its lids did while somebody spoke, with the sound."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from lipservo_lab.learning.learned_expression.expression_model import RATE_HZ
from lipservo_lab.learning.learned_expression.learned_expression import prosody_of
from lipsync.arrays import Array
from lipsync.audio_block import BLOCK_S, SAMPLE_RATE_HZ
from lipsync.errors import UserError
from lipsync.face.frame import Expression
from lipsync.prosody.voice_tracker import VoiceTracker
from lipsync.recognition.speech_file import read_speech

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


def nobody_watches(_what: str, _n_done: int, _n_all: int) -> None:
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
        """The values of some names, (n_frames, n)."""
        return np.stack([self.values[name] for name in names], axis=1)


@dataclass(frozen=True, slots=True)
class HeardTrack:
    """A track and what was heard: prosody (n_frames, 2), pitch and loudness z until each frame."""

    track: ExpressionTrack
    prosody: Array


def at_model_rate(times_s: Array, values: dict[str, Array]) -> dict[str, Array]:
    """Values at 25 Hz from 0 s to the last time, interpolated; before the first, held."""
    frames_s = np.arange(int(times_s[-1] * RATE_HZ + 1e-6) + 1) / RATE_HZ
    return {name: np.interp(frames_s, times_s, each) for name, each in values.items()}


def hear(
    tracks: Sequence[ExpressionTrack], progress: Progress = nobody_watches
) -> list[HeardTrack]:
    """The tracks with their prosody, as the live part hears it; one voice speaks them all.

    The same tracker hears one after the other, so that the voice is known from the second on.
    Raises SoundError.
    """
    tracker, heard = VoiceTracker(), []
    for number, track in enumerate(tracks, start=1):
        samples = read_speech(track.sound_path)
        heard.append(HeardTrack(track, prosody_frames(samples, track.n_frames, tracker)))
        progress("hearing", number, len(tracks))
    return heard


def prosody_frames(samples: np.ndarray, n_frames: int, tracker: VoiceTracker) -> Array:
    """(n_frames, 2): pitch and loudness z, means over the 40 ms before each frame.

    Sound that ends before the track is silence. Frame 0 has heard nothing yet.
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
