"""The sound of a performance, ready to be said: decoded, with silence at both ends."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import ceil
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Final

import numpy as np
from numpy.typing import NDArray

from lipsync.audio.file import CHUNK_S, Warn, read_sound
from lipsync.audio.playout import Playout
from lipsync.audio.playout_stream import PlayoutStream
from lipsync.audio.source import SoundError
from lipsync.offline.performance import Performance, PerformanceError
from lipsync.offline.performed_motion import EASING_S, StoredMotion
from lipsync.phonemes import PhonemeEvent

#: Faces last to the end of the sound, rounded up to 10 ms; formats differ by a packet.
_MOST_APART_S: Final = 0.1

Samples = NDArray[np.float32]


class PerformedStream(PlayoutStream):
    """A stream that brings its motion with it."""

    motion: StoredMotion


@dataclass(frozen=True, slots=True)
class PerformedLine:
    """The sound of a line, mono (n,) with `EASING_S` of silence before it and after its faces.

    phonemes: counted from the first sample of that silence.
    """

    name: str
    samples: Samples
    sample_rate_hz: int
    phonemes: tuple[PhonemeEvent, ...]
    motion: StoredMotion

    @property
    def duration_s(self) -> float:
        """With the silence."""
        return len(self.samples) / self.sample_rate_hz

    def stream(self, playout: Playout) -> PerformedStream:
        """An empty stream for the playout, that is to be given the chunks."""
        rates_hz = self.sample_rate_hz, playout.output_rate_hz
        stream = PerformedStream(self.name, *rates_hz, self.phonemes)
        stream.motion = self.motion
        return stream

    def chunks(self) -> Iterator[Samples]:
        """The samples, a second at a time."""
        n_chunk = round(CHUNK_S * self.sample_rate_hz)
        for start in range(0, len(self.samples), n_chunk):
            yield self.samples[start : start + n_chunk]


def performed_line(performance: Performance, path: Path, warn: Warn) -> PerformedLine:
    """The line of the performance that was read from `path`.

    warn: as `read_sound` has it. Raises PerformanceError where the sound is missing, another one,
    damaged, or not as long as the faces.
    """
    samples, rate_hz = _decoded(performance, path, warn)
    sound_s = len(samples) / rate_hz
    if abs(performance.duration_s - sound_s) > _MOST_APART_S:
        raise PerformanceError(
            f"{path}: damaged: faces for {performance.duration_s:.2f} s, sound for {sound_s:.2f} "
            "s; render it again with `lipservo render`"
        )
    return line_of(performance, path.name, samples, rate_hz)


def line_of(
    performance: Performance, name: str, samples: Samples, sample_rate_hz: int
) -> PerformedLine:
    """The same of a sound (n,) that is decoded already."""
    faces_longer_s = performance.duration_s - len(samples) / sample_rate_hz
    n_before = round(EASING_S * sample_rate_hz)
    n_after = ceil((max(0.0, faces_longer_s) + EASING_S) * sample_rate_hz)
    return PerformedLine(
        name,
        np.pad(samples, (n_before, n_after)),
        sample_rate_hz,
        tuple(_later(event) for event in performance.phonemes),
        StoredMotion(performance),
    )


def performed_in(playout: Playout) -> Callable[[float], tuple[StoredMotion, float] | None]:
    """What is performed at a sound time, by what the playout has committed: `PerformedMotion`."""

    def performed_at(sound_s: float) -> tuple[StoredMotion, float] | None:
        said = playout.stream_at(sound_s)
        if said is None or not isinstance(said[0], PerformedStream):
            return None
        return said[0].motion, said[1] - EASING_S

    return performed_at


def _decoded(performance: Performance, path: Path, warn: Warn) -> tuple[Samples, int]:
    content = performance.sound.bytes_beside(path)
    with TemporaryDirectory(prefix="lipservo-") as folder:
        file = Path(folder) / performance.sound.name
        file.write_bytes(content)

        def told(line: str) -> str:
            return f"{path}: its sound {line.replace(str(file), performance.sound.name)}"

        try:
            return read_sound(file, lambda line: warn(told(line)))
        except SoundError as error:
            raise PerformanceError(told(str(error))) from error


def _later(event: PhonemeEvent) -> PhonemeEvent:
    end_s = None if event.end_s is None else event.end_s + EASING_S
    return replace(event, start_s=event.start_s + EASING_S, end_s=end_s)
