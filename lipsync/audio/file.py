"""Sound files: WAV, FLAC, OGG, Opus and whatever else libsndfile reads, at 4 to 192 kHz.

Samples are mixed to mono by averaging the channels, or one is chosen; where they cancel each other,
the loudest is used alone. Float files may hold samples outside [-1, 1]; they are clipped there, as
any converter to a loudspeaker would, unless they are clearly whole numbers. Both, and a very quiet
file, are reported in a line.

The header and the first minute of sound are checked before anything moves, the rest while it is
played. So the first block of a file of hours comes as soon as that of a file of a minute, and a
file of up to a minute, as most are, is refused before it plays if anything is wrong.

Opening and checking the header decodes no sound: its time does not depend on the file's length.
"""

import io
import logging
import math
import os
import re
import stat
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import islice
from os import PathLike
from pathlib import Path
from typing import Final

import numpy as np
import soundfile
import soxr
from numpy.typing import NDArray

from lipsync.audio.channels import MIX, MOST_CHANNELS, channel_index
from lipsync.audio.compressed import (
    MP3,
    begins_as_mp3,
    lacks_its_end,
    present_share,
    quiet_decoder,
)
from lipsync.audio.source import BLOCK_SAMPLES, BlockCutter, SoundError
from lipsync.audio_block import SAMPLE_RATE_HZ, AudioBlock

_LOG: Final = logging.getLogger(__name__)
#: A telephone has 8 kHz, a studio 192; below 4 kHz there is no speech left to recognise.
SLOWEST_RATE_HZ, FASTEST_RATE_HZ = 4_000, 192_000
LONGEST_S = 1_000 * 3600.0
#: One analysis window of a recogniser; nothing can be recognised in less.
SHORTEST_S = 0.025
#: What programs write as a size before they know it (ffmpeg, arecord, sox into a pipe).
_UNKNOWN_BYTES = 0x7FFF_F000
#: A header whose data have no size, as a program leaves it that cannot go back to it.
_NO_SIZE = b"data\0\0\0\0"
_LONGEST_HEADER = 4096
#: Float samples beyond it are no overdriven sound but whole numbers.
_MOST_OVERDRIVEN = 8.0
#: The average of two channels has less of their energy only if one is the other turned round.
_LEAST_ENERGY = 0.01
_QUIET_DBFS = -50.0
#: An MP3 file with a smaller share of its bytes is cut off; programs count the tags or do not.
_NEARLY_ALL = 0.99
#: How libsndfile's log of a header says that less is there than was promised, in bytes.
_CUT_SHORT = re.compile(r"^\s*(?:data|SSND) : (\d+) \(should be (\d+)\)", re.MULTILINE)


def open_sound(path: Path) -> soundfile.SoundFile:
    """Open a sound file, ready to decode. Raises SoundError if it is missing or no sound file.

    A pipe or a device is refused without being opened: to open one can take for ever. Refused, too,
    are sample rates outside 4 to 192 kHz and more than 32 channels.
    """
    _refuse_other_than_files(path)
    try:
        with quiet_decoder(is_mp3=begins_as_mp3(path)):
            sound = soundfile.SoundFile(os.fsencode(path))  # names need not be UTF-8
        if sound.frames == 0 and sound.format == "WAV":
            sound = _reopen_unsized(path, sound)
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


class _SizedFile(io.FileIO):
    """A WAV file whose `data` size reads as unknown, ffffffff, though the file says 0.

    size_at: where in the file the four bytes of the size are.
    """

    def __init__(self, path: Path, size_at: int) -> None:
        super().__init__(os.fsencode(path))
        self._size_at = size_at

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]
        """Read bytes into `buffer`; return how many."""
        first = self.tell()
        n_read = super().readinto(buffer) or 0
        for position in range(max(first, self._size_at), min(first + n_read, self._size_at + 4)):
            memoryview(buffer).cast("B")[position - first] = 0xFF
        return n_read

    def __del__(self) -> None:
        """Close the file: a SoundFile that is closed lets go of it, and does not close it."""
        self.close()


def _reopen_unsized(path: Path, sound: soundfile.SoundFile) -> soundfile.SoundFile:
    """Return `sound`, or opened anew, to be read to its end, if its WAV header gives no size."""
    with path.open("rb") as file:
        start = file.read(_LONGEST_HEADER).find(_NO_SIZE)
    if start < 0:
        return sound
    sound.close()
    return soundfile.SoundFile(_SizedFile(path, start + 4))


def promised_s(sound: soundfile.SoundFile) -> float | None:
    """Return the length in s that the header promises, if the file is cut short; otherwise None.

    Only WAV and AIFF files are examined whose header gives a length; None for all others, where
    only decoding shows a cut.
    """
    match = _CUT_SHORT.search(sound.extra_info)
    if match is None:
        return None
    promised, present = int(match[1]), int(match[2])
    if promised >= _UNKNOWN_BYTES or not 0 < present < promised:
        return None
    return float(sound.frames / sound.samplerate * promised / present)


def reason_of(error: soundfile.LibsndfileError) -> str:
    """Return libsndfile's message for an error, or its number where the message is empty."""
    return str(error.error_string).strip().rstrip(".:") or f"libsndfile error {error.code}"


def _refuse_other_than_files(path: Path) -> None:
    """Raise SoundError unless `path` is a readable file with content; open no pipe or device."""
    try:
        mode = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError) as error:
        raise SoundError(f"{path}: no such file; check the path") from error
    except OSError as error:
        short = str(path)[:200]  # the name may be what is too long
        raise SoundError(f"{short}: cannot be read ({error.strerror}); check the path") from error
    except ValueError as error:  # a name with a zero byte
        raise SoundError(f"{str(path)!r}: no file can have this name; check the path") from error
    if stat.S_ISDIR(mode):
        raise SoundError(f"{path}: is a directory; give the path of a sound file")
    if not stat.S_ISREG(mode):
        raise SoundError(
            f"{path}: is a pipe or a device, not a file; save the sound to a file first, "
            "or listen with --mic"
        )
    try:
        with path.open("rb") as file:
            is_empty = not file.read(1)
    except OSError as error:
        raise SoundError(f"{path}: cannot be read ({error.strerror}); check rights") from error
    if is_empty:
        raise SoundError(f"{path}: the file is empty (0 bytes); record or copy it again")


def _refuse_odd_settings(path: Path, sound: soundfile.SoundFile) -> None:
    """Raise SoundError for a sample rate outside 4 to 192 kHz, or more than 32 channels."""
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
#: Pieces after the first with NaN or infinity in which such samples are counted, for the message.
_COUNTED = 60
#: Formats in which libsndfile 1.2 finds a sample exactly (measured: Vorbis and MP3 are off).
_SEEKS_EXACTLY = {"WAV", "WAVEX", "RF64", "W64", "AIFF", "AU", "CAF", "FLAC"}
_SILENT: Final = "; played as silence"
#: Decoding starts so much early where a resampler needs to settle; soxr's filter is shorter.
_RUN_IN_S = 0.25


@lru_cache(maxsize=256)
def log_once(line: str) -> None:
    """Log a line as a warning, only once for equal lines; nothing is logged for an empty line."""
    if line:
        _LOG.warning("%s", line)


@dataclass(frozen=True, slots=True)
class Mix:
    """How a file's samples become mono: of one `channel` (None: the average), times `gain`."""

    channel: int | None = None
    gain: float = 1.0

    def mono(self, chunk: Samples) -> Samples:
        """Return samples (n, n_channels) as mono (n,) in [-1, 1]."""
        if self.channel is not None:
            chunk = chunk[:, [self.channel]]
        mono: Samples = np.clip(chunk * np.float32(self.gain), -1.0, 1.0).mean(
            axis=1, dtype=np.float32
        )
        return mono


def read_sound(path: str | PathLike[str], channel: str = MIX) -> tuple[Samples, int]:
    """Return a whole file as samples (n,) float32 mono in [-1, 1], and its sample rate in hertz.

    channel: as in `FileSource`. Logs a line where the file is shorter than its header promises.
    Raises SoundError for whatever `FileSource` refuses, here wherever in the file it is.
    """
    path = Path(path)
    checked = checked_sound(path, channel)
    log_once(checked.warning)
    samples = np.concatenate([np.zeros(0, np.float32), *sound_chunks(path, checked.mix)])
    _refuse_empty(path, len(samples) / checked.sample_rate_hz, bool(np.any(samples)))
    return samples, checked.sample_rate_hz


@dataclass(frozen=True, slots=True)
class CheckedSound:
    """A file's own sample rate, and its length in seconds, to the nearest sample at 16 kHz.

    warning: a line for the log where the file is shorter than its header promises, or its samples
    are not taken as they are, else empty. mix: how they are taken.
    """

    sample_rate_hz: int
    duration_s: float
    warning: str
    mix: Mix


def checked_sound(path: Path, channel: str = MIX) -> CheckedSound:
    """Decode and check a file's first 60 s; return its rate, length and warning.

    channel: the one to be heard: `left`, `right`, `mix` or a number from 1. The length of a longer
    file is that in its header, less what an MP3 file lacks of it. Raises SoundError if it is
    damaged in the first 60 s, empty, silent as a whole, too short or too long, or lacks the
    channel.
    """
    n_frames, has_sound = 0, False
    levels = Levels()
    with open_sound(path) as sound:
        index = channel_index(channel, sound.channels, str(path))
        for chunk in _finite_chunks(path, sound):
            n_frames += len(chunk)
            levels.add(chunk if index is None else chunk[:, [index]])
            has_sound = levels.peak > 0.0
            if n_frames >= CHECKED_S * sound.samplerate:
                n_frames = round(sound.frames * present_share(path, sound))
                has_sound = True  # a minute of silence before speech is allowed
                break
        rate_hz = int(sound.samplerate)
        duration_s = n_frames / float(rate_hz)
        _refuse_empty(path, duration_s, has_sound)
        mix, remark = levels.mix(sound.subtype)
        if index is not None:
            mix = replace(mix, channel=index)
        remarks = [_cut_warning(path, sound, n_frames), remark and f"{path}: {remark}"]
        warning = "; ".join(filter(None, remarks))
    if duration_s > LONGEST_S:
        raise SoundError(
            f"{path}: its header gives no length, or more than {LONGEST_S / 3600:.0f} hours; "
            "convert it, for example with `ffmpeg -i IN OUT.wav`"
        )
    # The resampler rounds a half up; `round` would round it to even.
    duration_s = math.floor(duration_s * SAMPLE_RATE_HZ + 0.5) / SAMPLE_RATE_HZ
    return CheckedSound(rate_hz, duration_s, warning, mix)


@dataclass(slots=True)
class Levels:
    """Levels of a sound read so far. energy: of each channel; mean_energy: of their average."""

    peak: float = 0.0
    n_frames: int = 0
    energy: NDArray[np.float64] = field(default_factory=lambda: np.zeros(1))
    mean_energy: float = 0.0

    def add(self, chunk: Samples) -> None:
        """Add samples (n, n_channels)."""
        whole = chunk.astype(np.float64)
        self.peak = max(self.peak, float(np.abs(whole).max(initial=0.0)))
        self.n_frames += len(chunk)
        self.energy = self.energy + (whole**2).sum(axis=0)
        self.mean_energy += float((whole.mean(axis=1) ** 2).sum())

    def mix(self, subtype: str) -> tuple[Mix, str]:
        """Return how the samples become mono, and a line on what is odd about them, or "".

        subtype: of the file's samples, as libsndfile names it.
        """
        remarks: list[str] = []
        channel, gain = None, 1.0
        if subtype in ("FLOAT", "DOUBLE") and self.peak > _MOST_OVERDRIVEN:
            bits = next((each for each in (16, 24) if self.peak <= 2 ** (each - 1)), 32)
            gain = 2.0 ** (1 - bits)
            remarks.append(
                f"a float file with samples up to {self.peak:,.0f}, read as whole numbers of "
                f"{bits} bits"
            )
        energy = self.mean_energy
        if energy < _LEAST_ENERGY * float(self.energy.mean()):
            channel = int(self.energy.argmax())
            energy = float(self.energy[channel])
            remarks.append(f"its channels cancel each other; channel {channel + 1} alone is used")
        level_dbfs = 10.0 * math.log10(max(energy, 1e-30) / max(1, self.n_frames) * gain**2)
        if energy > 0.0 and level_dbfs < _QUIET_DBFS:
            remarks.append(f"very quiet, {level_dbfs:.0f} dBFS; record it louder")
        return Mix(channel, gain), "; ".join(remarks)


def sound_chunks(path: Path, mix: Mix) -> Iterator[Samples]:
    """Yield a file's sound, mono (n,) at its own rate, in pieces of 1 s.

    mix: of the file, as `checked_sound` found it. Raises SoundError where it is damaged or holds
    NaN or infinite samples.
    """
    with open_sound(path) as sound:
        yield from map(mix.mono, _finite_chunks(path, sound))


def played_chunks(
    path: Path, checked: CheckedSound, frame: int, lose: Callable[[int, str], None]
) -> Iterator[Samples]:
    """Yield what is played of a checked file from `frame` on, mono (n,) at its own rate, up to 1 s.

    Samples that are NaN or infinite become 0; after damage all is silence. lose: gets the number of
    samples at 16 kHz that were lost, and a line that says why.
    """
    with open_sound(path) as sound:
        rate_hz = sound.samplerate
        try:
            _seek_to(path, sound, frame)
            for chunk in _decode_chunks(path, sound):
                broken = ~np.isfinite(chunk)
                if broken.any():
                    n_lost = round(broken.any(axis=1).sum() * SAMPLE_RATE_HZ / rate_hz)
                    lose(n_lost, "samples that are no numbers" + _SILENT)
                    chunk = np.where(broken, np.float32(0.0), chunk)
                frame += len(chunk)
                yield checked.mix.mono(chunk)
        except SoundError as error:
            n_left = max(0, round(checked.duration_s * rate_hz) - frame)
            n_lost = round(n_left * SAMPLE_RATE_HZ / rate_hz)
            lose(n_lost, str(error).removeprefix(f"{path}: ") + _SILENT)
            for n_silent in range(n_left, 0, -rate_hz):
                yield np.zeros(min(n_silent, rate_hz), np.float32)


class FileSource:
    """A sound file as an `AudioSource`; the last block may be shorter than the others.

    Raises SoundError for a file that is missing, a directory, a pipe, a device, empty, not sound,
    of impossible settings, shorter than 25 ms or longer than 1,000 hours; and, within its first
    minute, for damage, samples that are NaN or infinite, and a whole file of nothing but zeros.
    Later NaN or infinite samples are played as silence, as is all that follows later damage, so
    that a face in motion goes on; this sound counts as lost blocks.
    """

    is_live = False

    def __init__(
        self, path: str | PathLike[str], *, start_s: float = 0.0, channel: str = MIX
    ) -> None:
        """Begin at the block that contains sound time `start_s`; times stay those of the file.

        The samples are those of a source that began at 0 (to rounding, where it is resampled); the
        sound before `start_s` is skipped without decoding, except for Ogg and MP3, which have to be
        decoded. channel: the one to be heard, `left`, `right`, `mix` or a number. Logs a line now
        if the file is shorter than its header promises, and one on `__exit__` if sound was played
        that could not be decoded.
        """
        self._path = Path(path)
        checked = checked_sound(self._path, channel)
        log_once(checked.warning)
        self._checked = checked
        self._n_unread = round(checked.duration_s * SAMPLE_RATE_HZ)
        first = math.floor(max(0.0, start_s) * SAMPLE_RATE_HZ + 1e-3)
        first = min(first // BLOCK_SAMPLES * BLOCK_SAMPLES, self._n_unread)
        self._n_unread -= first
        self._cutter = BlockCutter(first)
        self._chunks: Iterator[Samples] | None = self._speech_chunks(first)
        self._n_lost = 0
        self._decode_problem = ""

    @property
    def name(self) -> str:
        """The file's name without its folder."""
        return self._path.name

    @property
    def duration_s(self) -> float:
        """Length of the whole file in seconds, to the nearest sample at 16 kHz."""
        return self._checked.duration_s

    @property
    def lost_blocks(self) -> int:
        """The amount of sound that could not be decoded so far, in blocks of 10 ms, rounded up."""
        return -(-self._n_lost // BLOCK_SAMPLES)

    def blocks(self, until_s: float) -> list[AudioBlock]:
        """Return the blocks, not returned before, that end at or before sound time `until_s`."""
        while self._chunks is not None and self._cutter.held_until_s < until_s:
            if self._n_unread == 0:
                self._chunks = None
            else:
                # Never more than `duration_s` says: callers rely on when the sound ends.
                chunk = next(self._chunks)[: self._n_unread]
                self._n_unread -= len(chunk)
                self._cutter.push(chunk)
        ended = self._chunks is None
        return self._cutter.take_rest(until_s) if ended else self._cutter.take(until_s)

    def __enter__(self) -> "FileSource":
        return self

    def __exit__(self, *exc: object) -> None:
        self._chunks = None
        if self._decode_problem:
            log_once(f"{self._path}: {self._decode_problem}")

    def _speech_chunks(self, first: int) -> Iterator[Samples]:
        """Yield pieces (n,) of the file at 16 kHz from sample `first` on, then endless silence."""
        rate_hz = self._checked.sample_rate_hz
        frame = _first_frame(rate_hz, first)
        played = played_chunks(self._path, self._checked, frame, self._lose)
        yield from _resample_from(played, rate_hz, first)
        while True:
            yield np.zeros(SAMPLE_RATE_HZ, np.float32)

    def _lose(self, n_lost: int, trouble: str) -> None:
        """Add `n_lost` samples to the lost sound; keep the first `trouble`, for `__exit__`."""
        self._n_lost += n_lost
        self._decode_problem = self._decode_problem or trouble


def _resample_from(chunks: Iterator[Samples], rate_hz: int, first: int) -> Iterator[Samples]:
    """Yield `chunks` of a file at `rate_hz` resampled to 16 kHz, from its sample `first` on.

    The chunks begin at `_first_frame`; `first` counts samples at 16 kHz.
    """
    if rate_hz == SAMPLE_RATE_HZ:
        yield from chunks
        return
    resampler = soxr.ResampleStream(rate_hz, SAMPLE_RATE_HZ, 1, dtype="float32")
    n_early = first - _first_frame(rate_hz, first) * SAMPLE_RATE_HZ // rate_hz

    def without_early(samples: Samples) -> Samples:
        nonlocal n_early
        n_dropped = min(n_early, len(samples))
        n_early -= n_dropped
        return np.clip(samples[n_dropped:], -1.0, 1.0)

    for chunk in chunks:
        yield without_early(resampler.resample_chunk(chunk))
    yield without_early(resampler.resample_chunk(np.zeros(0, np.float32), last=True))


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


def _seek_to(path: Path, sound: soundfile.SoundFile, frame: int) -> None:
    """Move the position of `sound` so that the next sample decoded is number `frame`."""
    try:
        if sound.format in _SEEKS_EXACTLY and sound.seekable():
            sound.seek(min(frame, sound.frames))  # a restarted process may begin after the end
            return
        n_chunk = round(CHUNK_S * sound.samplerate)
        with quiet_decoder(is_mp3=sound.format in MP3):
            while frame > 0 and (n_read := len(sound.read(min(frame, n_chunk), dtype="float32"))):
                frame -= n_read
    except soundfile.LibsndfileError as error:
        raise _damage_error(path, sound, error) from error


def _decode_chunks(path: Path, sound: soundfile.SoundFile) -> Iterator[Samples]:
    """Yield the rest of `sound` in pieces (n, n_channels) of 1 s. Raises SoundError for damage."""
    n_chunk = round(CHUNK_S * sound.samplerate)
    while True:
        try:
            with quiet_decoder(is_mp3=sound.format in MP3):
                chunk: Samples = sound.read(n_chunk, dtype="float32", always_2d=True)
        except soundfile.LibsndfileError as error:
            raise _damage_error(path, sound, error) from error
        if len(chunk) == 0:
            return
        yield chunk


def _damage_error(
    path: Path, sound: soundfile.SoundFile, error: soundfile.LibsndfileError
) -> SoundError:
    """Return the SoundError for sound that cannot be decoded beyond the present position."""
    reached = f"{sound.tell() / sound.samplerate:.2f} s" if sound.seekable() else "some sound"
    return SoundError(
        f"{path}: damaged after {reached} ({reason_of(error)}); copy or convert it again"
    )


def _finite_chunks(path: Path, sound: soundfile.SoundFile) -> Iterator[Samples]:
    """Yield the undecoded rest of `sound` (n, n_channels); SoundError for NaN or infinity."""
    n_read = 0
    chunks = _decode_chunks(path, sound)
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
        yield chunk


def _cut_warning(path: Path, sound: soundfile.SoundFile, n_frames: int) -> str:
    """Return a line for the log if a file of `n_frames` frames is cut short, else ""."""
    holds_s = n_frames / sound.samplerate
    if lacks_its_end(path, sound):
        return f"{path}: cut short: its end is missing; the {holds_s:.2f} s that are there are used"
    says_s = promised_s(sound) or sound.frames / sound.samplerate
    # A compressed file's header counts in frames of up to a tenth of a second.
    is_cut = present_share(path, sound) < _NEARLY_ALL or holds_s + 0.1 < says_s
    if not (is_cut and holds_s < says_s < LONGEST_S):
        return ""
    return (
        f"{path}: cut short: its header promises {says_s:.2f} s, the file holds {holds_s:.2f} s; "
        "what is there is used"
    )


def _refuse_empty(path: Path, duration_s: float, has_sound: bool) -> None:
    """Raise SoundError for sound that is empty, below 25 ms, or zeros alone (no `has_sound`)."""
    if duration_s == 0.0:
        raise SoundError(f"{path}: has no sound (0 samples); record or export it again")
    if duration_s < SHORTEST_S:
        raise SoundError(
            f"{path}: {duration_s * 1000:.1f} ms of sound is too short; "
            f"at least {SHORTEST_S * 1000:.0f} ms are needed"
        )
    if not has_sound:
        raise SoundError(
            f"{path}: has only digital silence (every sample is zero); check how it was recorded"
        )


def read_speech(path: Path, channel: str = MIX) -> NDArray[np.float32]:
    """Return a sound file as mono at 16 kHz. Raises SoundError for whatever `FileSource` refuses.

    Parameters
    ----------
    path : Path
        Any format of libsndfile.
    channel : str
        The one to be heard: `left`, `right`, `mix` or a number from 1.

    Returns
    -------
    NDArray[np.float32]
        (n,) float32 in [-1, 1] at 16 kHz.
    """
    samples, rate_hz = read_sound(path, channel)
    if rate_hz == SAMPLE_RATE_HZ:
        return samples
    resampled: NDArray[np.float32] = soxr.resample(samples, rate_hz, SAMPLE_RATE_HZ)
    return np.clip(resampled, -1.0, 1.0)
