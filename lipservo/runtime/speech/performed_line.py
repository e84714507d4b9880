"""The sound of a performance, ready to be played: decoded as it plays, silence at both ends.

A performance is a scripted line whose motion was rendered to a file beforehand.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from lipsync.audio.file import checked_sound, log_once, sound_chunks
from lipsync.audio.playout import Playout
from lipsync.audio.playout_stream import PlayoutStream
from lipsync.audio.source import SoundError
from lipsync.offline.performance import Performance, PerformanceError, sound_file
from lipsync.offline.performed_motion import EASING_S, StoredMotion
from lipsync.phonemes import PhonemeEvent

#: Motion and sound may differ by so much in length: motion is rounded up to 10 ms, and sound
#: formats pad by a packet.
_MOST_APART_S: Final = 0.1

Samples = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class PerformedLine:
    """A performance's sound and motion with `EASING_S` of silence before and after.

    sounds: returns the sound, mono (n,) in pieces, from its beginning at every call. lasts_s:
    seconds of the sound and the silence after it. phonemes: times from the first sample of the
    silence.
    """

    name: str
    sounds: Callable[[], Iterator[Samples]]
    lasts_s: float
    sample_rate_hz: int
    phonemes: tuple[PhonemeEvent, ...]
    motion: StoredMotion

    def stream(self, playout: Playout) -> "PerformedStream":
        """Return a new, empty stream for `playout`, into which the caller pushes `chunks`."""
        return PerformedStream(self, playout.output_rate_hz)

    def chunks(self) -> Iterator[Samples]:
        """Yield silence, the sound in pieces of at most a second, and silence.

        Raises PerformanceError where the sound file has changed, or is damaged after its first
        minute.
        """
        n_left = ceil(self.lasts_s * self.sample_rate_hz)
        yield np.zeros(round(EASING_S * self.sample_rate_hz), np.float32)
        for chunk in self.sounds():
            yield chunk[:n_left]
            n_left -= min(n_left, len(chunk))
        yield np.zeros(n_left, np.float32)


class PerformedStream(PlayoutStream):
    """A playout stream that carries the stored motion of its performance."""

    def __init__(self, line: PerformedLine, output_rate_hz: int) -> None:
        """Create the stream of `line`. output_rate_hz: a multiple of 100, else ValueError."""
        super().__init__(line.name, line.sample_rate_hz, output_rate_hz, line.phonemes)
        self.motion = line.motion


def performed_line(performance: Performance, path: Path) -> PerformedLine:
    """Return the playable line of the performance that was read from `path`; its sound is checked.

    The sound is decoded later, as `PerformedLine.chunks` yields it. Raises PerformanceError where
    the sound is missing, has changed, is damaged within its first minute, or is not as long as the
    motion.
    """
    sound = performance.sound

    def sounds() -> Iterator[Samples]:
        with sound_file(sound, path) as file:
            try:
                yield from sound_chunks(file, mix=checked.mix)
            except SoundError as error:
                raise PerformanceError(_with_names(str(error), file)) from error

    def _with_names(line: str, file: Path) -> str:
        """Return a message in which the stored sound's name replaces the temporary file's."""
        return f"{path}: its sound {line.replace(str(file), sound.name)}"

    with sound_file(sound, path) as file:
        try:
            checked = checked_sound(file, sound.channel)
            if checked.warning:
                log_once(_with_names(checked.warning, file))
        except SoundError as error:
            raise PerformanceError(_with_names(str(error), file)) from error
    sound_s = checked.duration_s
    if abs(performance.duration_s - sound_s) > _MOST_APART_S:
        raise PerformanceError(
            f"{path}: damaged: its faces last {performance.duration_s:.2f} s, its sound "
            f"{sound_s:.2f} s; render it again with `lipservo lines render`"
        )
    return _make_line(performance, path.name, sounds, sound_s, checked.sample_rate_hz)


def line_of(
    performance: Performance, name: str, samples: Samples, sample_rate_hz: int
) -> PerformedLine:
    """Return the playable line of a performance whose sound is decoded already.

    name: of its stream. samples: (n,) mono, at `sample_rate_hz`.
    """
    sound_s = len(samples) / sample_rate_hz
    return _make_line(performance, name, lambda: iter([samples]), sound_s, sample_rate_hz)


def _make_line(
    performance: Performance,
    name: str,
    sounds: Callable[[], Iterator[Samples]],
    sound_s: float,
    sample_rate_hz: int,
) -> PerformedLine:
    """Return the playable line of a performance; its phonemes begin after the leading silence.

    name: of its stream. sounds: as in `PerformedLine`. sound_s: duration of the sound, s.
    """
    return PerformedLine(
        name,
        sounds,
        max(sound_s, performance.duration_s) + EASING_S,
        sample_rate_hz,
        # Later by the silence that precedes the sound.
        tuple(event.later(EASING_S) for event in performance.phonemes),
        StoredMotion(performance),
    )


def performed_in(playout: Playout) -> Callable[[float], tuple[StoredMotion, float] | None]:
    """Return a function that finds which stored motion the playout plays at a sound time, in s.

    It returns (motion, seconds since the motion's start), negative in the leading silence; None
    where no performance plays.
    """

    def performed_at(sound_s: float) -> tuple[StoredMotion, float] | None:
        stream = playout.stream_at(sound_s)
        if stream is None or not isinstance(stream[0], PerformedStream):
            return None
        return stream[0].motion, stream[1] - EASING_S

    return performed_at
