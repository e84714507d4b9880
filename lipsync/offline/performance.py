"""A performance: a line rendered for playing, its sound and its faces; and its file, `.perf`.

The file is one zip of arrays without pickle, versioned, written whole. Head and eyes are an
additional member; a lipservo that does not know it ignores it and plays the same mouth with its own
head motion. So files with and without head and eyes are version 1.
"""

import hashlib
import io
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from errno import EFBIG, ENOENT
from pathlib import Path
from tempfile import TemporaryFile, gettempdir
from typing import IO, Any, Final

import numpy as np
from numpy.typing import NDArray

from lipsync.array_archive import UNREADABLE, ArrayArchive, about_in
from lipsync.audio.channels import MIX, checked_channel
from lipsync.errors import UserError
from lipsync.face.model import FaceModel
from lipsync.output_file import write_whole
from lipsync.phonemes import VISEME_OF, PhonemeEvent

#: Faces a second, as the face publishes them.
RATE_HZ = 100.0
#: The longest performance that is written or read; `render` takes up to half of it.
LONGEST_S = 600.0
#: Of an `Expression`, what may be stored. A smile is a mood of the moment, which nobody knows yet.
EXPRESSION_NAMES: Final = (
    "neck_pitch_deg", "neck_yaw_deg", "neck_roll_deg", "eye_pitch_deg", "eye_yaw_deg",
    "lid_left", "lid_right", "brow",
)  # fmt: skip


class PerformanceError(UserError):
    """Error for a performance that cannot be played; the message says why and what to do."""


@dataclass(frozen=True, slots=True)
class PerformedSound:
    """The sound of a performance, byte for byte the file that it was rendered from.

    name: of that file, without folders. sha256: of its bytes, 64 hex digits. content: the bytes
    that are to be written into the performance file; None where the sound stays a file beside the
    performance, and in every performance read from a file: `sound_file` gives access to its sound.
    channel: the one that was rendered, and that a face plays; "": all are mixed.
    """

    name: str
    sha256: str
    content: bytes | None
    channel: str = ""


def performed_sound(path: Path, *, included: bool, channel: str = "") -> PerformedSound:
    """Return the name and SHA-256 of the sound file `path`, and its bytes if `included`, else None.

    Raises PerformanceError if the file cannot be read.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise PerformanceError(f"{path}: cannot be read ({error.strerror})") from error
    digest = hashlib.sha256(content).hexdigest()
    return PerformedSound(path.name, digest, content if included else None, channel)


@dataclass(frozen=True, slots=True)
class Performance:
    """A rendered line; it can be played by every face that is calibrated for its face model.

    face_checksum: of that face model. coefficients: (n, n_components) float32, frame i at i / 100 s
    of sound time. phonemes: in order, each with its end. method: name of the method that rendered
    it. expression: the values (n,) float32 of some `EXPRESSION_NAMES` at the same times, in units
    of `Expression`; empty: head and eyes are left to the face that plays it. origin: a digest of
    all that it was rendered from; "": not known.
    """

    face_checksum: str
    coefficients: NDArray[np.float32]
    phonemes: tuple[PhonemeEvent, ...]
    sound: PerformedSound
    method: str
    expression: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)
    origin: str = ""

    @property
    def duration_s(self) -> float:
        """Seconds of sound time from the first face to the last."""
        return (len(self.coefficients) - 1) / RATE_HZ

    def check_face(self, face: FaceModel, name: str) -> None:
        """Raise PerformanceError unless this performance was rendered for the face model `face`.

        name: the file of this performance, for the error message.
        """
        if face.checksum != self.face_checksum:
            raise PerformanceError(
                f"{name}: rendered for face model {self.face_checksum}, this face is "
                f"{face.checksum}; render it again with `lipservo lines render --model`"
            )
        if self.coefficients.shape[1] != face.n_components:
            raise PerformanceError(
                f"{name}: damaged: it has {self.coefficients.shape[1]} coefficients per face, its "
                f"model {face.n_components}; render it again with `lipservo lines render`"
            )


#: Raised whenever the meaning of a stored field changes.
PERFORMANCE_VERSION = 1
#: What such a file is called.
SUFFIX = ".perf"
_MOST_FACES: Final = round(LONGEST_S * RATE_HZ) + 1
#: Twice as many as the fastest talkers have.
_MOST_PHONEMES_PER_S: Final = 50
#: Ten minutes of 48 kHz in stereo are 115 MB; `render` takes five.
_MOST_SOUND_BYTES: Final = 120_000_000
_MOST_SOUND_BESIDE_BYTES: Final = 1_000_000_000
#: Unpacked: of what `about` says a phoneme takes 50 bytes, of 64 coefficients a face 256.
_MOST_OF: Final = {"about": 2_000_000, "coefficients": 16_000_000, "expression": 8_000_000}
_MOST_BYTES: Final = _MOST_SOUND_BYTES + 30_000_000
_CHUNK_BYTES: Final = 1 << 20
_MOST_DEG = 180.0
_KIND = "lipservo performance"
_ABOUT, _SOUND = "about", "sound"
_RENDER_AGAIN = "render it again with `lipservo lines render`"


def write_performance(performance: Performance, path: Path) -> None:
    """Write a performance to the file `path`, or nothing. Raises OutputError, PerformanceError."""
    write_whole(path, performance_bytes(performance))


def performance_bytes(performance: Performance) -> bytes:
    """Return the content of the file of a performance: an .npz archive, `about` first.

    Raises PerformanceError if the faces last more than 10 minutes or the sound exceeds 120 MB.
    """
    if performance.duration_s > LONGEST_S:
        raise PerformanceError(f"the line is longer than {LONGEST_S / 60:g} minutes; cut it")
    sound = performance.sound
    about: dict[str, object] = {
        "kind": _KIND,
        "version": PERFORMANCE_VERSION,
        "face": performance.face_checksum,
        "method": performance.method,
        "rate_hz": RATE_HZ,
        "phonemes": [[e.phoneme, e.start_s, e.end_s] for e in performance.phonemes],
        "sound": {
            "name": sound.name,
            "sha256": sound.sha256,
            "included": sound.content is not None,
            "channel": sound.channel or MIX,
        },
    }
    if performance.expression:
        about["expression"] = list(performance.expression)
    if performance.origin:
        about["origin"] = performance.origin
    arrays: dict[str, NDArray[Any]] = {
        _ABOUT: np.frombuffer(json.dumps(about).encode(), dtype=np.uint8),
        "coefficients": performance.coefficients.astype(np.float32),
    }
    if sound.content is not None:
        if len(sound.content) > _MOST_SOUND_BYTES:
            raise PerformanceError(
                f"{sound.name}: more than {_MOST_SOUND_BYTES // 10**6} MB of sound; convert it to "
                "FLAC, or render with --reference-sound"
            )
        arrays[_SOUND] = np.frombuffer(sound.content, dtype=np.uint8)
    if performance.expression:
        columns = list(performance.expression.values())
        arrays["expression"] = np.stack(columns, axis=1).astype(np.float32)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()


def is_performance(head: bytes) -> bool:
    """Return whether a file's first bytes are those of a performance."""
    return _KIND.encode() in about_in(head)


def read_performance(path: Path) -> Performance:
    """Return the performance in a file, without the bytes of its sound, which `sound_file` reads.

    Raises PerformanceError, a message of one line, if the file cannot be read or is no valid
    performance.
    """
    with _open_archive(path) as archive:
        about = json.loads(archive[_ABOUT].tobytes())
        if not isinstance(about, dict) or about.get("kind") != _KIND:
            raise PerformanceError(f"{path}: not a performance; {_RENDER_AGAIN}")
        if about["version"] != PERFORMANCE_VERSION or about["rate_hz"] != RATE_HZ:
            raise PerformanceError(
                f"{path}: performance version {about['version']} at {about['rate_hz']} "
                f"faces/s, this lipservo plays version {PERFORMANCE_VERSION} at {RATE_HZ:g}; "
                + _RENDER_AGAIN
            )
        if about["sound"]["included"] != (_SOUND in archive):
            raise ValueError("its sound is not at the place that it names")
        channel = checked_channel(about["sound"].get("channel", MIX))
        faces = _checked_faces(archive["coefficients"])
        return Performance(
            face_checksum=str(about["face"]),
            coefficients=faces,
            phonemes=_checked_phonemes(about["phonemes"], len(faces)),
            sound=PerformedSound(
                _checked_name(about["sound"]["name"]), str(about["sound"]["sha256"]), None, channel
            ),
            method=str(about["method"]),
            expression=_checked_expression(about, archive, len(faces)),
            origin=str(about.get("origin", "")),
        )


@contextmanager
def sound_file(sound: PerformedSound, path: Path) -> Iterator[Path]:
    """Yield the path of a file with the sound `sound` of the performance that was read from `path`.

    The file is the sound file beside the performance, or, for sound included in it, an unnamed
    temporary file that is deleted afterwards in any case; so the sound is never in memory as a
    whole. Raises PerformanceError where the sound cannot be read, or has changed since rendering.
    """
    digest = hashlib.sha256()
    with ExitStack() as stack:
        place = path.parent / sound.name
        with _open_archive(path) as archive:
            if _SOUND in archive:
                file = stack.enter_context(_open_unnamed_file())
                place = Path(f"/dev/fd/{file.fileno()}")
                for chunk in archive.chunks(_SOUND):
                    digest.update(chunk)
                    _write_chunk(file, chunk)
            else:
                for chunk in _read_chunks(place, path):
                    digest.update(chunk)
        if digest.hexdigest() != sound.sha256:
            raise PerformanceError(
                f"{path}: its sound {sound.name} is not the one it was rendered from; render again"
            )
        yield place


def _open_unnamed_file() -> IO[bytes]:
    try:
        return TemporaryFile(prefix="lipservo-", buffering=0)
    except OSError as error:
        raise _temporary_file_error(error) from error


def _write_chunk(file: IO[bytes], chunk: bytes) -> None:
    try:
        file.write(chunk)
    except OSError as error:
        raise _temporary_file_error(error) from error


def _temporary_file_error(error: OSError) -> PerformanceError:
    return PerformanceError(
        f"{gettempdir()}: the sound of a performance cannot be put there ({error.strerror}); make "
        "room, or set TMPDIR"
    )


def _read_chunks(place: Path, performance: Path) -> Iterator[bytes]:
    """Yield the bytes of the sound file `place` in chunks of 1 MiB.

    Raises PerformanceError, naming the file `performance`, if the sound is unreadable or too large.
    """
    try:
        if not place.is_file():  # a pipe would be waited for without end
            raise FileNotFoundError(ENOENT, "no such file")
        if place.stat().st_size > _MOST_SOUND_BESIDE_BYTES:
            raise OSError(EFBIG, f"it is over {_MOST_SOUND_BESIDE_BYTES // 10**6} MB")
        with place.open("rb") as file:
            while chunk := file.read(_CHUNK_BYTES):
                yield chunk
    except OSError as error:
        raise PerformanceError(
            f"{performance}: its sound {place} cannot be read ({error.strerror}); put it there, or "
            "render without --reference-sound"
        ) from error


@contextmanager
def _open_archive(path: Path) -> Iterator[ArrayArchive]:
    """Yield the open archive of a performance; reading errors are raised as PerformanceError."""
    try:
        # A pipe in its place would be waited for without end.
        if path.exists() and not path.is_file():
            raise PerformanceError(
                f"{path}: not a file; name one that `lipservo lines render` wrote"
            )
        with path.open("rb") as file, ArrayArchive(file, _MOST_BYTES, _MOST_OF) as archive:
            yield archive
    except PerformanceError:
        raise
    except (KeyError, TypeError, IndexError, AttributeError, *UNREADABLE) as error:
        if isinstance(error, OSError) and error.strerror:
            raise PerformanceError(f"{path}: cannot be read ({error.strerror})") from error
        raise PerformanceError(
            f"{path}: damaged or not a performance ({error}); {_RENDER_AGAIN}"
        ) from error


def _checked_expression(
    about: dict[str, Any], archive: ArrayArchive, n_frames: int
) -> dict[str, NDArray[np.float32]]:
    """Return the stored head and eye values (n_frames,) by name; unknown names are left out.

    about: the parsed header of `archive`. Raises ValueError for a wrong shape or values beyond 180.
    """
    if "expression" not in about:
        return {}
    names, values = list(about["expression"]), archive["expression"]
    if values.shape != (n_frames, len(names)) or not (np.abs(values) <= _MOST_DEG).all():
        raise ValueError(f"expression has shape {values.shape}, or impossible values")
    columns = dict(zip(names, values.astype(np.float32).T, strict=True))
    return {name: columns[name] for name in EXPRESSION_NAMES if name in columns}


def _checked_faces(faces: NDArray[Any]) -> NDArray[np.float32]:
    if len(faces.shape) == 2 and len(faces) > _MOST_FACES:
        raise ValueError(f"{len(faces)} faces, more than {LONGEST_S / 60:g} minutes")
    if faces.ndim != 2 or not len(faces) or not np.isfinite(faces).all():
        raise ValueError(f"coefficients have shape {faces.shape}, or values that are not finite")
    return faces.astype(np.float32, copy=False)


def _checked_phonemes(rows: Sequence[Any], n_faces: int) -> tuple[PhonemeEvent, ...]:
    # A second more, so that a line of one word may have as many as it likes.
    if len(rows) > _MOST_PHONEMES_PER_S * (n_faces / RATE_HZ + 1.0):
        raise ValueError(f"{len(rows)} phonemes are too many for {n_faces / RATE_HZ:.1f} s")
    return tuple(_checked_event(*row) for row in rows)


def _checked_event(phoneme: str, start_s: float, end_s: float) -> PhonemeEvent:
    if phoneme not in VISEME_OF or not (0.0 <= start_s < end_s < math.inf):
        raise ValueError(f"phoneme {phoneme!r} from {start_s} to {end_s} s is impossible")
    return PhonemeEvent(phoneme, float(start_s), float(end_s))


def _checked_name(name: str) -> str:
    """Return the sound's file name; raise ValueError if it includes a folder, for safety."""
    if not isinstance(name, str) or name in ("", ".", "..") or Path(name).name != name:
        raise ValueError(f"sound name {name!r} is not a plain file name")
    return name
