"""One take: pictures and sound from the same instant on, in files that are complete or missing.

`warnings_of`: what is wrong with a take, as far as numbers show, for a person who can repeat it.
"""

from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
import soundfile
from numpy.typing import NDArray

from lipservo.calibrating.camera import Frame
from lipservo_lab.recording.clip_writer import ClipWriter
from lipservo_lab.recording.sentence_list import Sentence
from lipsync.audio_block import SAMPLE_RATE_HZ, AudioBlock
from lipsync.output_file import write_whole, written_whole

Samples = NDArray[np.float32]

#: Samples of this size are at the end of the converter's range.
_FULL_SCALE: Final = 0.999
#: Number of such samples that counts as clipped; a single one cannot be heard.
_FEWEST_CLIPPED: Final = 3
_WINDOW_S: Final = 0.05
#: Least level of the loudest tenth of the windows, dB below full scale; speech near a microphone is
#: at -30 to -15.
_QUIETEST_DB: Final = -42.0
#: Least level of speech above the quietest tenth: with less the room is noisy, or no one spoke.
_LEAST_ABOVE_NOISE_DB: Final = 12.0
#: Least mean brightness of a picture, of 255: below it skin and lips look alike to a camera.
_DARKEST: Final = 50.0
#: Least share of the promised pictures.
_FEWEST_FRAMES: Final = 0.9
#: A longer time without a picture may hide a closure of the lips (P lasts 80 ms).
_LONGEST_GAP_S: Final = 0.1
#: Fewer pictures a second do not show how lips close.
SLOWEST_HZ: Final = 24.0
_SHORTEST_S: Final = 0.7


def sound_level_db(samples: Samples) -> float:
    """Return the root mean square of samples, (n,), in dB below full scale, -90 at least."""
    if not len(samples):
        return -90.0
    return max(-90.0, 10.0 * float(np.log10(np.mean(np.square(samples, dtype=np.float64)) + 1e-9)))


def warnings_of(
    samples: Samples,
    frames_s: Sequence[float],
    brightness: Sequence[float],
    rate_hz: float,
    lost_blocks: int = 0,
) -> tuple[str, ...]:
    """Return one line for each thing that is wrong with a take; none for a good take.

    samples: (n,) at 16 kHz; frames_s: times of the pictures; brightness: means of some of them, 0
    to 255; rate_hz: pictures a second that the camera promised; lost_blocks: blocks of 10 ms of
    sound that were lost.
    """
    duration_s = len(samples) / SAMPLE_RATE_HZ
    found = []
    if duration_s < _SHORTEST_S:
        found.append(f"only {duration_s:.1f} s long: was the whole sentence said?")
    found += _sound_faults(samples)
    if lost_blocks:
        found.append(f"{10 * lost_blocks} ms of sound were lost: close other programs")
    found += _picture_faults(np.asarray(frames_s), duration_s, rate_hz)
    if len(brightness) and np.mean(brightness) < _DARKEST:
        found.append(
            f"too dark (brightness {np.mean(brightness):.0f} of 255): put a lamp before the face"
        )
    return tuple(found)


def _sound_faults(samples: Samples) -> list[str]:
    """Return what is wrong with a sound (n,): clipped, quiet, or noisy; at most one line."""
    n_clipped = int((np.abs(samples) >= _FULL_SCALE).sum())
    if n_clipped >= _FEWEST_CLIPPED:
        return [f"{n_clipped} samples clipped: turn the microphone down or sit farther away"]
    window = round(_WINDOW_S * SAMPLE_RATE_HZ)
    n = len(samples) // window
    if not n:
        return []
    levels = [sound_level_db(part) for part in samples[: n * window].reshape(n, window)]
    loud_db, noise_db = float(np.quantile(levels, 0.9)), float(np.quantile(levels, 0.1))
    if loud_db < _QUIETEST_DB:
        return [f"too quiet ({loud_db:.0f} dB): turn the microphone up or come nearer"]
    if loud_db - noise_db < _LEAST_ABOVE_NOISE_DB:
        return [
            f"speech is only {loud_db - noise_db:.0f} dB above the noise: was the sentence said, "
            "with a moment of silence before it?"
        ]
    return []


def _picture_faults(frames_s: NDArray[np.float64], duration_s: float, rate_hz: float) -> list[str]:
    """Return what is wrong with the pictures: none, too few a second, or a gap; at most one line.

    frames_s: (n,), time of each picture from the first one on. rate_hz: promised by the camera.
    """
    if len(frames_s) < 2:
        return ["no pictures: does the camera work?"]
    found_hz = (len(frames_s) - 1) / float(frames_s[-1] - frames_s[0])
    gaps_s = np.diff(np.append(frames_s, max(duration_s, frames_s[-1])))
    if found_hz < max(SLOWEST_HZ - 0.5, _FEWEST_FRAMES * rate_hz):
        return [
            f"{found_hz:.1f} pictures a second, {rate_hz:.0f} were promised: more light, or a "
            "smaller picture (--size)"
        ]
    if gaps_s.max() > _LONGEST_GAP_S:
        return [f"{1e3 * gaps_s.max():.0f} ms without a picture: close other programs"]
    return []


#: A take begins so long after the key and ends so long before: keys can be heard.
KEY_S = 0.15
#: Every so many pictures the brightness is measured; every so many rows of it are used.
_BRIGHTNESS_EVERY = 5
_ROW_STEP = 4


class TakeDiscarded(Exception):  # noqa: N818 - a wish of a person, not an error
    """Raised inside `take_files` to discard the take: no file of it stays."""


@contextmanager
def take_files(folder: Path, sentence: Sentence) -> Iterator[tuple[Path, Path]]:
    """Yield the paths to write a clip and its sound to; the files get their names at the end.

    The text is written last: if it exists, the others are complete. If anything is raised the
    folder stays as it was; TakeDiscarded is not raised further.
    """
    place = folder / sentence.name
    text = place.with_suffix(".txt")
    try:
        with (
            written_whole(place.with_suffix(".wav")) as sound,
            written_whole(place.with_suffix(".mkv")) as clip,
        ):
            yield clip, sound
            # For a repeated take: without its text the old take is invalid until the new one is
            # complete.
            text.unlink(missing_ok=True)
    except TakeDiscarded:
        return
    write_whole(text, f"{sentence.text}\n")


class Take:
    """Collects sound and pictures as they come, from sound time `begins_s` to `end`.

    clip: path of the film. zero_s: when sound time 0 was captured, on the clock of the pictures.
    Clip and sound begin with the first picture.
    """

    def __init__(self, clip: Path, begins_s: float, zero_s: float, rate_hz: float) -> None:
        """Open the clip; see the class for the times.

        rate_hz: pictures a second that the camera promised.
        """
        self._writer = ClipWriter(clip, rate_hz)
        self._begins_s, self._zero_s, self._rate_hz = begins_s, zero_s, rate_hz
        self._ends_s = np.inf
        self._pending: deque[Frame] = deque()
        self._first_s: float | None = None
        self._blocks: list[AudioBlock] = []
        self._frames_s: list[float] = []
        self._brightness: list[float] = []

    def add_blocks(self, blocks: Sequence[AudioBlock]) -> None:
        """Append sound, in order."""
        self._blocks += [b for b in blocks if b.end_s > self._begins_s]

    def add_frames(self, frames: Sequence[Frame]) -> None:
        """Append pictures, in order, and write those that are surely in the take."""
        self._pending += [(taken_s - self._zero_s, picture) for taken_s, picture in frames]
        # A take ends before the key that ends it, so newer pictures may not belong to it.
        until_s = self._blocks[-1].end_s - KEY_S if self._blocks else 0.0
        self._write_frames(min(until_s, self._ends_s))

    def end(self, sound_s: float) -> None:
        """Set the sound time at which the take ends, at most `KEY_S` ago.

        Sound and pictures until then may still be added.
        """
        self._ends_s = sound_s

    def _write_frames(self, until_s: float) -> None:
        """Write the waiting pictures up to a sound time, s; drop those before the take."""
        while self._pending and self._pending[0][0] < until_s:
            sound_s, picture = self._pending.popleft()
            if sound_s < self._begins_s:
                continue
            if self._first_s is None:
                self._first_s = sound_s
            if not self._writer.add_frame(sound_s - self._first_s, picture):
                continue
            if len(self._frames_s) % _BRIGHTNESS_EVERY == 0:
                self._brightness.append(brightness(picture))
            self._frames_s.append(sound_s - self._first_s)

    @property
    def is_empty(self) -> bool:
        """Whether no picture or no sound has come."""
        return not self._frames_s or not len(self._samples())

    def finish(self, sound: Path, lost_blocks: int) -> tuple[str, ...]:
        """Write clip and sound; return warnings about them.

        sound: path. Neither may be empty. lost_blocks: blocks of sound that were lost.
        """
        self._write_frames(self._ends_s)
        samples = self._samples()
        self._writer.finish(samples)
        soundfile.write(str(sound), samples, SAMPLE_RATE_HZ, format="WAV", subtype="PCM_16")
        return warnings_of(samples, self._frames_s, self._brightness, self._rate_hz, lost_blocks)

    def close(self) -> None:
        """Close the clip's file."""
        self._writer.close()

    def _samples(self) -> NDArray[np.float32]:
        """Return the samples from the first picture to the end, (n,)."""
        if self._first_s is None or not self._blocks:
            return np.zeros(0, np.float32)
        samples = np.concatenate([block.samples for block in self._blocks])
        offset_s = self._blocks[0].start_s
        first = max(0, round((self._first_s - offset_s) * SAMPLE_RATE_HZ))
        last = round(min(self._ends_s - offset_s, len(samples) / SAMPLE_RATE_HZ) * SAMPLE_RATE_HZ)
        return samples[first:last]


def brightness(picture: Any) -> float:
    """Return the mean of an av.VideoFrame's luma, 0 to 255; of its colours if it has no luma.

    Read from the first plane, as FFmpeg's converter may not be used on a picture in two threads.
    """
    plane, packed = picture.planes[0], picture.format.name
    rows = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)
    # Packed formats have chroma in every other byte; planar formats in other planes.
    first, step = {"yuyv422": (0, 2), "uyvy422": (1, 2)}.get(packed, (0, 1))
    used = picture.width * (2 if step == 2 else 1)
    return float(rows[::_ROW_STEP, first:used:step].mean())
