"""Films from pictures and sound: H.264 and AAC in MP4, by PyAV, written whole or not at all.

Both have one time axis that begins with the first sample: picture n is shown at n / rate, and the
player skips the samples that the encoder puts before the sound (an edit list).
"""

import errno
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from lipsync.audio.file import CheckedSound, Samples, checked_sound, log_once, sound_chunks
from lipsync.errors import UserError, check_extra
from lipsync.face.frame import Frame
from lipsync.output_file import written_whole
from lipsync.video.face_detection import Picture

FILM_RATE_HZ = 25
#: Endings of a film's name; the ending chooses the file format.
FILM_ENDINGS = (".mp4", ".mov", ".mkv")
#: Speech is encoded as well at this rate as at any other, and every player knows it.
_SOUND_RATE_HZ = 48_000
_SOUND_BITS_PER_S = 128_000
#: Constant rate factor of x264: 18 can hardly be told from the picture itself.
_QUALITY = "18"
#: Samples of sound in a block of the AAC encoder.
_SAMPLES_A_FRAME = 1024


class FilmError(UserError):
    """Error for a film that cannot be made; one line says which one, why, and the remedy."""


class Display(Protocol):
    """A drawing of a face that turns a frame, mouth shape and expression, into a picture."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""

    def draw(self, frame: Frame) -> Picture:
        """Return the frame's picture, (height, width, 3), red, green, blue."""


def named_file(speech: str) -> Path | None:
    """Return the path if `speech` is the name of a file; None: a text to speak."""
    return Path(speech) if Path(speech).suffix and " " not in speech else None


def is_file(path: Path | None) -> bool:
    """Return whether there is a file at `path`, which may be a text to speak; None: False."""
    try:
        return path is not None and path.is_file()
    except OSError:  # a text, too long for a file's name
        return False


def check_film(path: Path) -> None:
    """Raise FilmError for a file name without a film's ending, MissingExtraError without PyAV."""
    if path.suffix.lower() not in FILM_ENDINGS:
        raise FilmError(f"{path}: a film's name must end in {' or '.join(FILM_ENDINGS)}")
    check_extra("av", "making a film")


def is_film(head: bytes) -> bool:
    """Return whether a file with these first bytes is an MP4, MOV or Matroska file."""
    return head[4:8] == b"ftyp" or head.startswith(b"\x1a\x45\xdf\xa3")


def film(
    frames: Iterable[Frame],
    sound: Path | None,
    face: Display,
    out: Path,
    *,
    rate_hz: int = FILM_RATE_HZ,
    progress: Callable[[int], None] = lambda _n: None,
) -> int:
    """Film a face: one picture per frame, frame n at sound time n / rate_hz; return their number.

    sound: the sound file; None: a silent film. face: draws the pictures. out: the film's file,
    replaced if it exists. progress: called with the number of pictures so far. Raises FilmError,
    OutputError, SoundError.
    """
    return write_film(
        (face.draw(frame) for frame in frames), face.size, sound, out, rate_hz, progress
    )


def write_film(
    pictures: Iterable[Picture],
    size: tuple[int, int],
    sound: Path | None,
    out: Path,
    rate_hz: int = FILM_RATE_HZ,
    progress: Callable[[int], None] = lambda _n: None,
) -> int:
    """Write pictures and their sound as a film; return the number of pictures.

    size: width and height in px of each picture, even. sound: the sound file; None: a silent film.
    out: the film's file, replaced if it exists. rate_hz: pictures a second. progress: called with
    the number of pictures so far. Raises FilmError, OutputError, SoundError, MissingExtraError.
    """
    check_film(out)
    import av

    checked = None if sound is None else checked_sound(sound)
    n = 0
    with written_whole(out) as partial, _film_errors(out, av.FFmpegError):
        # FFmpeg's name of the container format.
        kind = {"mkv": "matroska"}.get(out.suffix.lower()[1:], out.suffix.lower()[1:])
        # MP4 and MOV get their index at the front.
        options = {} if kind == "matroska" else {"movflags": "faststart"}
        with open_film(str(partial), "w", format=kind, options=options) as file:
            video = file.add_stream(
                "libx264", rate=rate_hz, options={"crf": _QUALITY, "preset": "veryfast"}
            )
            video.width, video.height = size
            video.pix_fmt = "yuv420p"
            video.time_base = Fraction(1, rate_hz)
            sound_track = None
            if sound is not None and checked is not None:
                sound_track = _SoundTrack(file, _resampled_pieces(sound, checked))
            for n, picture in enumerate(pictures, start=1):
                if sound_track is not None:
                    sound_track.encode_until(n / rate_hz)
                video_frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
                video_frame.pts, video_frame.time_base = n - 1, Fraction(1, rate_hz)
                file.mux(video.encode(video_frame))
                progress(n)
            if sound_track is not None:
                sound_track.encode_until(n / rate_hz)
                sound_track.end()
            file.mux(video.encode(None))
        if not n:
            raise FilmError(f"{out}: the sound is empty, so there is nothing to film")
    return n


def open_film(*given: Any, **how: Any) -> Any:
    """Open a film to read or write it; arguments and result are those of PyAV's `av.open`."""
    import av

    return av.open(*given, **how)


class _SoundTrack:
    """The sound track of an open film, read and encoded in step with its pictures.

    pieces: mono samples at 48 kHz, a piece at a time; they are encoded as two equal channels.
    """

    def __init__(self, file: Any, pieces: Iterator[Samples]) -> None:
        self._file, self._pieces = file, pieces
        self._buffered = np.zeros(0, np.float32)
        self._stream = file.add_stream("aac", rate=_SOUND_RATE_HZ, layout="stereo")
        self._stream.bit_rate = _SOUND_BITS_PER_S
        self._n_encoded = 0

    def encode_until(self, time_s: float) -> None:
        """Encode the next samples in blocks, up to at least `time_s` or the sound's end."""
        end_sample = round(time_s * _SOUND_RATE_HZ)
        while self._n_encoded < end_sample:
            while len(self._buffered) < _SAMPLES_A_FRAME:
                piece = next(self._pieces, None)
                if piece is None:
                    break
                self._buffered = np.concatenate([self._buffered, piece])
            block, self._buffered = np.split(self._buffered, [_SAMPLES_A_FRAME])
            if not len(block):
                return
            self._encode(np.stack([block, block]))
            self._n_encoded += len(block)

    def _encode(self, block: Samples) -> None:
        """Encode one block, (2, n) samples, and write it into the film behind the blocks before."""
        import av

        sound = av.AudioFrame.from_ndarray(block, format="fltp", layout="stereo")
        sound.sample_rate = _SOUND_RATE_HZ
        sound.pts, sound.time_base = self._n_encoded, Fraction(1, _SOUND_RATE_HZ)
        self._file.mux(self._stream.encode(sound))

    def end(self) -> None:
        """Flush the encoder into the film, after the last samples."""
        self._file.mux(self._stream.encode(None))


def _resampled_pieces(sound: Path, checked: CheckedSound) -> Iterator[Samples]:
    """Yield a sound at the film's rate in pieces of a second: never all of it is held."""
    import soxr

    log_once(checked.warning)
    resampler = soxr.ResampleStream(checked.sample_rate_hz, _SOUND_RATE_HZ, 1, dtype="float32")
    for chunk in sound_chunks(sound, mix=checked.mix):
        yield np.clip(resampler.resample_chunk(chunk), -1.0, 1.0)
    yield np.clip(resampler.resample_chunk(np.zeros(0, np.float32), last=True), -1.0, 1.0)


@contextmanager
def _film_errors(out: Path, fault: type[Exception]) -> Iterator[None]:
    """Turn a block's error of type `fault` into OSError if it has an errno, else into FilmError.

    OSError is the disk's, which `written_whole` reports; FilmError names the film `out`.
    """
    try:
        yield
    except fault as error:
        number = getattr(error, "errno", None)
        if isinstance(number, int) and number in errno.errorcode:
            raise OSError(number, os.strerror(number)) from error
        raise FilmError(f"{out}: cannot be filmed ({getattr(error, 'strerror', error)})") from error
