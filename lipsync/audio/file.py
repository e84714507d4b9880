"""Sound files: WAV, FLAC, OGG, Opus and whatever else libsndfile reads, at 4 to 192 kHz.

Samples are mixed to mono by averaging the channels. Float files may hold samples outside [-1, 1];
they are clipped there, as any converter to a loudspeaker would.

The header and the first minute of sound are checked before anything moves, the rest while it is
played. So the first block of a file of hours comes as soon as that of a file of a minute, and a
file of up to a minute, as most are, is refused before it plays if anything is wrong.

Opening and checking the header decodes no sound: its time does not depend on the file's length.
"""

import logging
import math
import os
import re
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from os import PathLike
from pathlib import Path
from typing import Final

import numpy as np
import soundfile
import soxr
from numpy.typing import NDArray

from lipsync.audio.source import BLOCK_SAMPLES, BlockCutter, SoundError
from lipsync.audio_block import SAMPLE_RATE_HZ, AudioBlock

_LOG: Final = logging.getLogger(__name__)
#: A telephone has 8 kHz, a studio 192; below 4 kHz there is no speech left to recognise.
SLOWEST_RATE_HZ, FASTEST_RATE_HZ = 4_000, 192_000
#: More than any recorder writes; a header that says more is damaged.
MOST_CHANNELS = 32
LONGEST_S = 1_000 * 3600.0
#: One analysis window of a recogniser; nothing can be recognised in less.
SHORTEST_S = 0.025
#: What programs write as a size before they know it (ffmpeg, arecord, sox into a pipe).
_UNKNOWN_BYTES = 0x7FFF_F000
#: How libsndfile's log of a header says that less is there than was promised, in bytes.
_CUT_SHORT = re.compile(r"^\s*(?:data|SSND) : (\d+) \(should be (\d+)\)", re.MULTILINE)


def open_sound(path: Path) -> soundfile.SoundFile:
    """Open a sound file, ready to decode. Raises SoundError if it is missing or no sound file.

    A pipe or a device is refused without being opened: to open one can take for ever. Refused, too,
    are sample rates outside 4 to 192 kHz and more than 32 channels.
    """
    _refuse_other_than_files(path)
    try:
        sound = soundfile.SoundFile(os.fsencode(path))  # names need not be UTF-8
    except soundfile.LibsndfileError as error:
        raise SoundError(
            f"{path}: not a sound file that can be read ({reason_of(error)}); "
            "use WAV, FLAC, OGG or Opus"
        ) from error
    try:
        _refuse_odd_settings(path, sound)
    except SoundError:
        sound.close()
        raise
    return sound


def promised_s(sound: soundfile.SoundFile) -> float | None:
    """Return the length in s that the header promises, if the file is cut short; otherwise None.

    Only WAV and AIFF files are examined whose header gives a length; None for all others, where
    only decoding shows a cut.
    """
    found = _CUT_SHORT.search(sound.extra_info)
    if found is None:
        return None
    promised, there = int(found[1]), int(found[2])
    if promised >= _UNKNOWN_BYTES or not 0 < there < promised:
        return None
    return float(sound.frames / sound.samplerate * promised / there)


def reason_of(error: soundfile.LibsndfileError) -> str:
    """Return libsndfile's message for an error, or its number where the message is empty."""
    return str(error.error_string).strip().rstrip(".:") or f"libsndfile error {error.code}"


def _refuse_other_than_files(path: Path) -> None:
    try:
        kind = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError) as error:
        raise SoundError(f"{path}: no such file; check the path") from error
    except OSError as error:
        raise SoundError(f"{path}: cannot be read ({error.strerror}); check its rights") from error
    except ValueError as error:  # a name with a zero byte
        raise SoundError(f"{str(path)!r}: no file can have this name; check the path") from error
    if stat.S_ISDIR(kind):
        raise SoundError(f"{path}: is a directory; give the path of a sound file")
    if not stat.S_ISREG(kind):
        raise SoundError(
            f"{path}: is a pipe or a device, not a file; save the sound to a file first, "
            "or listen with --mic"
        )
    try:
        with path.open("rb") as file:
            is_empty = not file.read(1)
    except OSError as error:
        raise SoundError(f"{path}: cannot be read ({error.strerror}); check its rights") from error
    if is_empty:
        raise SoundError(f"{path}: the file is empty (0 bytes); record or copy it again")


def _refuse_odd_settings(path: Path, sound: soundfile.SoundFile) -> None:
    if not SLOWEST_RATE_HZ <= sound.samplerate <= FASTEST_RATE_HZ:
        raise SoundError(
            f"{path}: a sample rate of {sound.samplerate} Hz is not possible here "
            f"({SLOWEST_RATE_HZ} to {FASTEST_RATE_HZ} Hz are); export the file again"
        )
    if sound.channels > MOST_CHANNELS:
        raise SoundError(
            f"{path}: {sound.channels} channels are not possible here (up to {MOST_CHANNELS} "
            "are); export the file again"
        )


Samples = NDArray[np.float32]

#: Files are decoded in pieces this long, so that hours of sound need no more memory than seconds.
CHUNK_S = 1.0
#: So much is decoded before anything moves.
CHECKED_S = 60.0
#: Pieces after the first broken one in which more of the same is counted, for the message.
_COUNTED = 60
#: Formats in which libsndfile 1.2 finds a sample exactly (measured: Vorbis and MP3 are off).
_SEEKS_EXACTLY = {"WAV", "WAVEX", "RF64", "W64", "AIFF", "AU", "CAF", "FLAC"}
#: A resampler that starts in the middle of a file is right after so much; soxr's filter is shorter.
_RUN_IN_S = 0.25


@lru_cache(maxsize=256)
def log_once(line: str) -> None:
    """Log a line as a warning, only once for equal lines; nothing is logged for an empty line."""
    if line:
        _LOG.warning("%s", line)


def read_sound(path: str | PathLike[str]) -> tuple[Samples, int]:
    """Return a whole file as samples (n,) float32 mono in [-1, 1], and its sample rate in hertz.

    Logs a line where the file is shorter than its header promises. Raises SoundError for whatever
    `FileSource` refuses, here wherever in the file it is.
    """
    path = Path(path)
    with open_sound(path) as sound:
        samples = np.concatenate([np.zeros(0, np.float32), *_mono_chunks(path, sound)])
        sample_rate_hz = int(sound.samplerate)
        _refuse_nothing(path, len(samples) / sample_rate_hz, bool(np.any(samples)))
        log_once(_cut_short(path, sound, len(samples)))
    return samples, sample_rate_hz


@dataclass(frozen=True, slots=True)
class CheckedSound:
    """A file's own sample rate, and its length in seconds, to the nearest sample at 16 kHz.

    warning: a line for the log where the file is shorter than its header promises, else empty.
    """

    sample_rate_hz: int
    duration_s: float
    warning: str


def checked_sound(path: Path) -> CheckedSound:
    """Decode and check a file's first 60 s; return its rate, length and warning.

    The length of a longer file is that of its header. Raises SoundError if it is damaged in the
    first 60 s, empty, silent as a whole, too short or too long.
    """
    n_frames, has_sound = 0, False
    with open_sound(path) as sound:
        for chunk in _mono_chunks(path, sound):
            n_frames += len(chunk)
            has_sound = has_sound or bool(np.any(chunk))
            if n_frames >= CHECKED_S * sound.samplerate:
                n_frames = sound.frames
                has_sound = True  # or not yet: a minute of silence before speech is allowed
                break
        rate_hz = int(sound.samplerate)
        duration_s = n_frames / float(rate_hz)
        _refuse_nothing(path, duration_s, has_sound)
        warning = _cut_short(path, sound, n_frames)
    if duration_s > LONGEST_S:
        raise SoundError(
            f"{path}: its header does not say how long it is, or more than "
            f"{LONGEST_S / 3600:.0f} hours; convert it, with `ffmpeg -i IN OUT.wav` for one"
        )
    # The resampler rounds a half up; `round` would round it to even.
    duration_s = math.floor(duration_s * SAMPLE_RATE_HZ + 0.5) / SAMPLE_RATE_HZ
    return CheckedSound(rate_hz, duration_s, warning)


def sound_chunks(path: str | PathLike[str], start_s: float = 0.0) -> Iterator[Samples]:
    """Yield a file's sound from `start_s` on, mono (n,) at its own rate, in pieces of 1 s.

    Raises SoundError where it is damaged or holds NaN or infinite samples.
    """
    path = Path(path)
    with open_sound(path) as sound:
        _go_to(path, sound, round(start_s * sound.samplerate))
        yield from _mono_chunks(path, sound)


class FileSource:
    """A sound file as an `AudioSource`; the last block may be shorter than the others.

    Raises SoundError for a file that is missing, a directory, a pipe, a device, empty, not sound,
    of impossible settings, shorter than 25 ms or longer than 1,000 hours; and, within its first
    minute, for damage, samples that are NaN or infinite, and a whole file of nothing but zeros.
    Later NaN or infinite samples are played as silence, as is all that follows later damage, so
    that a face in motion goes on; this sound counts as lost blocks.
    """

    is_live = False

    def __init__(self, path: str | PathLike[str], *, start_s: float = 0.0) -> None:
        """Begin at the block that contains sound time `start_s`; times stay those of the file.

        The samples are those of a source that began at 0 (to rounding, where it is resampled); the
        sound before `start_s` is skipped without decoding, except for Ogg and MP3, which have to be
        decoded. Logs a line now if the file is shorter than its header promises, and one on
        `__exit__` if sound was played that could not be decoded.
        """
        self._path = Path(path)
        checked = checked_sound(self._path)
        log_once(checked.warning)
        self._duration_s = checked.duration_s
        self._n_left = round(self._duration_s * SAMPLE_RATE_HZ)
        first = math.floor(max(0.0, start_s) * SAMPLE_RATE_HZ + 1e-3)
        first = min(first // BLOCK_SAMPLES * BLOCK_SAMPLES, self._n_left)
        self._n_left -= first
        self._cutter = BlockCutter(first)
        self._chunks: Iterator[Samples] | None = self._speech_chunks(first)
        self._n_lost = 0
        self._trouble = ""

    @property
    def name(self) -> str:
        """The file's name without its folder."""
        return self._path.name

    @property
    def duration_s(self) -> float:
        """Length of the whole file in seconds, to the nearest sample at 16 kHz."""
        return self._duration_s

    @property
    def lost_blocks(self) -> int:
        """The amount of sound that could not be decoded so far, in blocks of 10 ms, rounded up."""
        return -(-self._n_lost // BLOCK_SAMPLES)

    def blocks(self, until_s: float) -> list[AudioBlock]:
        """Return the blocks, not returned before, that end at or before sound time `until_s`."""
        while self._chunks is not None and self._cutter.held_until_s < until_s:
            if self._n_left == 0:
                self._chunks = None
            else:
                # Never more than was promised: others count on when the sound ends.
                chunk = next(self._chunks)[: self._n_left]
                self._n_left -= len(chunk)
                self._cutter.push(chunk)
        ended = self._chunks is None
        return self._cutter.take_rest(until_s) if ended else self._cutter.take(until_s)

    def __enter__(self) -> "FileSource":
        return self

    def __exit__(self, *exc: object) -> None:
        self._chunks = None
        if self._trouble:
            log_once(f"{self._path}: {self._trouble}")

    def _speech_chunks(self, first: int) -> Iterator[Samples]:
        """Yield pieces (n,) of the file at 16 kHz from sample `first` on, then endless silence."""
        with open_sound(self._path) as sound:
            yield from _resampled(self._played_chunks(sound, first), sound.samplerate, first)
        while True:
            yield np.zeros(SAMPLE_RATE_HZ, np.float32)

    def _played_chunks(self, sound: soundfile.SoundFile, first: int) -> Iterator[Samples]:
        """Yield the file's sound mono (n,) at its own rate, until its end or the first damage.

        It begins at the frame that `_first_frame` gives for `first`, a sample at 16 kHz. Samples
        that are NaN or infinite become 0; these and all after damage are counted as lost.
        """
        try:
            _go_to(self._path, sound, _first_frame(sound.samplerate, first))
            for chunk in _chunks(self._path, sound):
                broken = ~np.isfinite(chunk)
                if broken.any():
                    lost = broken.any(axis=1)
                    self._lose(int(lost.sum()) / sound.samplerate, "samples that are no numbers")
                    chunk = np.where(broken, np.float32(0.0), chunk)
                yield _mono(chunk)
        except SoundError as error:
            missing_s = max(0.0, self._duration_s - sound.tell() / sound.samplerate)
            self._lose(missing_s, str(error).removeprefix(f"{self._path}: "))

    def _lose(self, lost_s: float, trouble: str) -> None:
        self._n_lost += round(lost_s * SAMPLE_RATE_HZ)
        self._trouble = self._trouble or f"{trouble}; played as silence"


def _resampled(chunks: Iterator[Samples], rate_hz: int, first: int) -> Iterator[Samples]:
    """Yield `chunks` of a file at `rate_hz` resampled to 16 kHz, from its sample `first` on.

    The chunks begin at `_first_frame`; `first` counts samples at 16 kHz.
    """
    if rate_hz == SAMPLE_RATE_HZ:
        yield from chunks
        return
    resampler = soxr.ResampleStream(rate_hz, SAMPLE_RATE_HZ, 1, dtype="float32")
    n_early = first - _first_frame(rate_hz, first) * SAMPLE_RATE_HZ // rate_hz

    def later(samples: Samples) -> Samples:
        nonlocal n_early
        n_dropped = min(n_early, len(samples))
        n_early -= n_dropped
        return np.clip(samples[n_dropped:], -1.0, 1.0)

    for chunk in chunks:
        yield later(resampler.resample_chunk(chunk))
    yield later(resampler.resample_chunk(np.zeros(0, np.float32), last=True))


def _first_frame(rate_hz: int, first: int) -> int:
    """Return the file's frame at which decoding must begin for sample `first` at 16 kHz.

    For a file of another `rate_hz` it is 0.25 s early, as its resampler has to settle, and at a
    frame that coincides with a sample at 16 kHz.
    """
    if rate_hz == SAMPLE_RATE_HZ:
        return first
    common = math.gcd(rate_hz, SAMPLE_RATE_HZ)
    early = max(0, first - round(_RUN_IN_S * SAMPLE_RATE_HZ))
    return early // (SAMPLE_RATE_HZ // common) * (rate_hz // common)


def _go_to(path: Path, sound: soundfile.SoundFile, frame: int) -> None:
    """Move the position of `sound` so that the next sample decoded is number `frame`."""
    try:
        if sound.format in _SEEKS_EXACTLY:
            sound.seek(frame)
            return
        n_chunk = round(CHUNK_S * sound.samplerate)
        while frame > 0 and (n_read := len(sound.read(min(frame, n_chunk), dtype="float32"))):
            frame -= n_read
    except soundfile.LibsndfileError as error:
        raise _damaged(path, sound, error) from error


def _chunks(path: Path, sound: soundfile.SoundFile) -> Iterator[Samples]:
    """Yield the undecoded rest of `sound` in pieces (n, n_channels) of 1 s."""
    n_chunk = round(CHUNK_S * sound.samplerate)
    while True:
        try:
            chunk: Samples = sound.read(n_chunk, dtype="float32", always_2d=True)
        except soundfile.LibsndfileError as error:
            raise _damaged(path, sound, error) from error
        if len(chunk) == 0:
            return
        yield chunk


def _damaged(
    path: Path, sound: soundfile.SoundFile, error: soundfile.LibsndfileError
) -> SoundError:
    return SoundError(
        f"{path}: damaged after {sound.tell() / sound.samplerate:.2f} s "
        f"({reason_of(error)}); copy or convert it again"
    )


def _mono_chunks(path: Path, sound: soundfile.SoundFile) -> Iterator[Samples]:
    """Yield the undecoded rest of `sound` mono (n,) in [-1, 1]; SoundError for NaN or infinity."""
    n_read = 0
    chunks = _chunks(path, sound)
    for chunk in chunks:
        broken = ~np.isfinite(chunk)
        if broken.any():
            first_s = (n_read + int(np.argmax(broken.any(axis=1)))) / sound.samplerate
            n_broken = int(broken.sum())
            n_broken += sum(int((~np.isfinite(c)).sum()) for c in islice(chunks, _COUNTED))
            raise SoundError(
                f"{path}: {n_broken} samples are not numbers (NaN or infinite), "
                f"the first at {first_s:.4f} s; export the file again"
            )
        n_read += len(chunk)
        yield _mono(chunk)


def _mono(chunk: Samples) -> Samples:
    mono: Samples = np.clip(chunk, -1.0, 1.0).mean(axis=1, dtype=np.float32)
    return mono


def _cut_short(path: Path, sound: soundfile.SoundFile, n_frames: int) -> str:
    holds_s = n_frames / sound.samplerate
    says_s = promised_s(sound) or sound.frames / sound.samplerate
    # A compressed file's header counts in frames of up to a tenth of a second.
    if not holds_s + 0.1 < says_s < LONGEST_S:
        return ""
    return (
        f"{path}: cut short: its header promises {says_s:.2f} s, the file holds {holds_s:.2f} s; "
        "what is there is used"
    )


def _refuse_nothing(path: Path, duration_s: float, has_sound: bool) -> None:
    if duration_s == 0.0:
        raise SoundError(f"{path}: holds no sound (0 samples); record or export it again")
    if duration_s < SHORTEST_S:
        raise SoundError(
            f"{path}: {duration_s * 1000:.1f} ms of sound is too short; "
            f"at least {SHORTEST_S * 1000:.0f} ms are needed"
        )
    if not has_sound:
        raise SoundError(
            f"{path}: holds only digital silence (every sample is zero); check how it was recorded"
        )


def read_speech(path: Path) -> NDArray[np.float32]:
    """Return a sound file as mono at 16 kHz. Raises SoundError for whatever `FileSource` refuses.

    Parameters
    ----------
    path : Path
        Any format of libsndfile.

    Returns
    -------
    NDArray[np.float32]
        (n,) float32 in [-1, 1] at 16 kHz.
    """
    samples, rate_hz = read_sound(path)
    if rate_hz == SAMPLE_RATE_HZ:
        return samples
    resampled: NDArray[np.float32] = soxr.resample(samples, rate_hz, SAMPLE_RATE_HZ)
    return np.clip(resampled, -1.0, 1.0)
