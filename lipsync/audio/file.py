"""Sound files: WAV, FLAC, OGG, Opus and whatever else libsndfile reads, at any rate.

Samples are mixed to mono by averaging the channels. Float files may hold samples outside [-1, 1];
they are clipped there, as any converter to a loudspeaker would.
"""

import math
import os
from collections.abc import Iterator
from os import PathLike
from pathlib import Path

import numpy as np
import soundfile
import soxr
from numpy.typing import NDArray

from lipsync.audio.block import SAMPLE_RATE_HZ, AudioBlock
from lipsync.audio.cutter import BlockCutter
from lipsync.audio.source import SoundError

#: Files are decoded in pieces this long, so that hours of sound need no more memory than seconds.
CHUNK_S = 1.0
#: One analysis window of a recogniser; nothing can be heard in less.
SHORTEST_S = 0.025


def read_sound(path: str | PathLike[str]) -> tuple[NDArray[np.float32], int]:
    """The whole file as samples (n,) float32 mono in [-1, 1], and its own sample rate in hertz.

    Raises SoundError for what `FileSource` refuses.
    """
    path = Path(path)
    with _open(path) as sound:
        samples = np.concatenate([np.zeros(0, np.float32), *_mono_chunks(path, sound)])
        sample_rate_hz = int(sound.samplerate)
    _refuse_nothing(path, len(samples) / sample_rate_hz, bool(np.any(samples)))
    return samples, sample_rate_hz


class FileSource:
    """A sound file as an `AudioSource`; the last block may be shorter than the others.

    The whole file is decoded once at construction, piece by piece, so that a file that cannot be
    used is refused before anything moves, and a second time while it plays; it is never whole in
    memory. Raises SoundError for a file that is missing, a directory, empty, not sound, damaged,
    shorter than 25 ms, nothing but zeros, or holding NaN or infinite samples.
    """

    is_live = False
    lost_blocks = 0

    def __init__(self, path: str | PathLike[str]) -> None:
        self._path = Path(path)
        self._duration_s = _checked_duration_s(self._path)
        self._chunks: Iterator[NDArray[np.float32]] | None = _speech_chunks(self._path)
        self._cutter = BlockCutter()

    @property
    def name(self) -> str:
        """The file's name without its folder."""
        return self._path.name

    @property
    def duration_s(self) -> float:
        """Length of the sound in seconds, to the nearest sample at 16 kHz."""
        return self._duration_s

    def blocks(self, until_s: float) -> list[AudioBlock]:
        """The blocks not handed out before that end at or before sound time `until_s`."""
        while self._chunks is not None and self._cutter.held_until_s < until_s:
            chunk = next(self._chunks, None)
            if chunk is None:
                self._chunks = None
            else:
                self._cutter.push(chunk)
        ended = self._chunks is None
        return self._cutter.take_rest(until_s) if ended else self._cutter.take(until_s)

    def __enter__(self) -> "FileSource":
        return self

    def __exit__(self, *exc: object) -> None:
        self._chunks = None


def _open(path: Path) -> soundfile.SoundFile:
    try:
        with path.open("rb") as file:
            is_empty = not file.read(1)
    except FileNotFoundError as error:
        raise SoundError(f"{path}: no such file; check the path") from error
    except IsADirectoryError as error:
        raise SoundError(f"{path}: is a directory; give the path of a sound file") from error
    except OSError as error:
        raise SoundError(f"{path}: cannot be read ({error.strerror}); check its rights") from error
    if is_empty:
        raise SoundError(f"{path}: the file is empty (0 bytes); record or copy it again")
    try:
        return soundfile.SoundFile(os.fsencode(path))  # names need not be UTF-8
    except soundfile.LibsndfileError as error:
        raise SoundError(
            f"{path}: not a sound file that can be read ({error.error_string.rstrip('.')}); "
            "use WAV, FLAC, OGG or Opus"
        ) from error


def _chunks(path: Path, sound: soundfile.SoundFile) -> Iterator[NDArray[np.float32]]:
    """The rest of `sound` as it is, in pieces (n, n_channels) of `CHUNK_S`."""
    n_chunk = round(CHUNK_S * sound.samplerate)
    while True:
        try:
            chunk: NDArray[np.float32] = sound.read(n_chunk, dtype="float32", always_2d=True)
        except soundfile.LibsndfileError as error:
            raise SoundError(
                f"{path}: damaged after {sound.tell() / sound.samplerate:.2f} s "
                f"({error.error_string.rstrip('.')}); copy or convert it again"
            ) from error
        if len(chunk) == 0:
            return
        yield chunk


def _mono_chunks(path: Path, sound: soundfile.SoundFile) -> Iterator[NDArray[np.float32]]:
    """`_chunks` mixed to mono (n,) in [-1, 1]; SoundError when one holds what is no number."""
    n_read = 0
    chunks = _chunks(path, sound)
    for chunk in chunks:
        broken = ~np.isfinite(chunk)
        if broken.any():
            first_s = (n_read + int(np.argmax(broken.any(axis=1)))) / sound.samplerate
            n_broken = int(broken.sum()) + sum(int((~np.isfinite(c)).sum()) for c in chunks)
            raise SoundError(
                f"{path}: {n_broken} samples are not numbers (NaN or infinite), "
                f"the first at {first_s:.4f} s; export the file again"
            )
        n_read += len(chunk)
        yield np.clip(chunk, -1.0, 1.0).mean(axis=1, dtype=np.float32)


def _speech_chunks(path: Path) -> Iterator[NDArray[np.float32]]:
    """The file in pieces of any length, (n,) each, mono in [-1, 1] at 16 kHz."""
    with _open(path) as sound:
        if sound.samplerate == SAMPLE_RATE_HZ:
            yield from _mono_chunks(path, sound)
            return
        resampler = soxr.ResampleStream(sound.samplerate, SAMPLE_RATE_HZ, 1, dtype="float32")
        for chunk in _mono_chunks(path, sound):
            yield np.clip(resampler.resample_chunk(chunk), -1.0, 1.0)
        tail = resampler.resample_chunk(np.zeros(0, np.float32), last=True)
        yield np.clip(tail, -1.0, 1.0)


def _checked_duration_s(path: Path) -> float:
    """Decode the file once; its length in whole samples at 16 kHz, in seconds, or SoundError."""
    n_samples, heard = 0, False
    with _open(path) as sound:
        for chunk in _mono_chunks(path, sound):
            n_samples += len(chunk)
            heard = heard or bool(np.any(chunk))
        duration_s = n_samples / float(sound.samplerate)
    _refuse_nothing(path, duration_s, heard)
    # The resampler rounds a half up; `round` would round it to even.
    return math.floor(duration_s * SAMPLE_RATE_HZ + 0.5) / SAMPLE_RATE_HZ


def _refuse_nothing(path: Path, duration_s: float, heard: bool) -> None:
    if duration_s == 0.0:
        raise SoundError(f"{path}: holds no sound (0 samples); record or export it again")
    if duration_s < SHORTEST_S:
        raise SoundError(
            f"{path}: {duration_s * 1000:.1f} ms of sound is too short; "
            f"at least {SHORTEST_S * 1000:.0f} ms are needed"
        )
    if not heard:
        raise SoundError(
            f"{path}: holds only digital silence (every sample is zero); check how it was recorded"
        )
