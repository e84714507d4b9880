"""One take: pictures and sound from the same moment on, in files that are whole or not there."""

from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import soundfile
from numpy.typing import NDArray

from lipservo.calibrating.camera import Frame
from lipservo_lab.recording.clip_writer import ClipWriter
from lipservo_lab.recording.sentence_list import Sentence
from lipservo_lab.recording.take_quality import warnings_of
from lipsync.audio_block import SAMPLE_RATE_HZ, AudioBlock
from lipsync.output_file import write_whole, written_whole

#: A take begins so long after its key and ends so long before: the keys are heard, too.
KEY_S = 0.15
#: Every so many pictures one is looked at for its brightness.
_LOOKED_AT = 5
_ROW_STEP = 4


class TakeDiscarded(Exception):  # noqa: N818 - a wish of a person, not an error
    """The take is not to be kept: raise it inside `take_files`, and nothing stays."""


@contextmanager
def take_files(folder: Path, sentence: Sentence) -> Iterator[tuple[Path, Path]]:
    """Where to write the clip and its sound; with the text they take their names at the end.

    The text is last: where it is, the others are. Whatever is raised inside leaves the folder as
    it was; TakeDiscarded goes no farther.
    """
    place = folder / sentence.name
    text = place.with_suffix(".txt")
    try:
        with (
            written_whole(place.with_suffix(".wav")) as sound,
            written_whole(place.with_suffix(".mkv")) as clip,
        ):
            yield clip, sound
            # A take that is said again: without its text it is none until all is there again.
            text.unlink(missing_ok=True)
    except TakeDiscarded:
        return
    write_whole(text, f"{sentence.text}\n")


class Take:
    """Sound and pictures as they come, from sound time `begins_s` to `end`.

    zero_s: when sound time 0 was captured, on the clock that pictures are timed by. The clip begins
    with its first picture, and so does the sound.
    """

    def __init__(self, clip: Path, begins_s: float, zero_s: float, rate_hz: float) -> None:
        self._writer = ClipWriter(clip, rate_hz)
        self._begins_s, self._zero_s, self._rate_hz = begins_s, zero_s, rate_hz
        self._ends_s = np.inf
        self._pending: deque[Frame] = deque()
        self._first_s: float | None = None
        self._blocks: list[AudioBlock] = []
        self._frames_s: list[float] = []
        self._brightness: list[float] = []

    def add_blocks(self, blocks: Sequence[AudioBlock]) -> None:
        """What was heard, in order."""
        self._blocks += [b for b in blocks if b.end_s > self._begins_s]

    def add_frames(self, frames: Sequence[Frame]) -> None:
        """What was seen, in order."""
        self._pending += [(taken_s - self._zero_s, picture) for taken_s, picture in frames]
        # A take ends before the key that ends it: what may be cut off is not written yet.
        until_s = self._blocks[-1].end_s - KEY_S if self._blocks else 0.0
        self._write_frames(min(until_s, self._ends_s))

    def end(self, sound_s: float) -> None:
        """The take ends there, `KEY_S` ago or later; sound and pictures until then may come."""
        self._ends_s = sound_s

    def _write_frames(self, until_s: float) -> None:
        while self._pending and self._pending[0][0] < until_s:
            sound_s, picture = self._pending.popleft()
            if sound_s < self._begins_s:
                continue
            if self._first_s is None:
                self._first_s = sound_s
            if not self._writer.add_frame(sound_s - self._first_s, picture):
                continue
            if len(self._frames_s) % _LOOKED_AT == 0:
                self._brightness.append(brightness(picture))
            self._frames_s.append(sound_s - self._first_s)

    @property
    def is_empty(self) -> bool:
        """Whether no picture or no sound has come."""
        return not self._frames_s or not len(self._samples())

    def finish(self, sound: Path, lost_blocks: int) -> tuple[str, ...]:
        """Write clip and sound, neither of them empty; what is wrong with them."""
        self._write_frames(self._ends_s)
        samples = self._samples()
        self._writer.finish(samples)
        soundfile.write(str(sound), samples, SAMPLE_RATE_HZ, format="WAV", subtype="PCM_16")
        return warnings_of(samples, self._frames_s, self._brightness, self._rate_hz, lost_blocks)

    def close(self) -> None:
        """Give the clip's file back."""
        self._writer.close()

    def _samples(self) -> NDArray[np.float32]:
        """From the first picture to the end."""
        if self._first_s is None or not self._blocks:
            return np.zeros(0, np.float32)
        samples = np.concatenate([block.samples for block in self._blocks])
        offset_s = self._blocks[0].start_s
        first = max(0, round((self._first_s - offset_s) * SAMPLE_RATE_HZ))
        last = round(min(self._ends_s - offset_s, len(samples) / SAMPLE_RATE_HZ) * SAMPLE_RATE_HZ)
        return samples[first:last]


def brightness(picture: Any) -> float:
    """Mean of an av.VideoFrame's luma, 0 to 255; of its colours where it has no luma.

    Read off the first plane: FFmpeg's converter must not be in two threads with one picture.
    """
    plane, packed = picture.planes[0], picture.format.name
    rows = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)
    # Packed formats have chroma in every other byte; planar ones have planes of their own for it.
    first, step = {"yuyv422": (0, 2), "uyvy422": (1, 2)}.get(packed, (0, 1))
    used = picture.width * (2 if step == 2 else 1)
    return float(rows[::_ROW_STEP, first:used:step].mean())
