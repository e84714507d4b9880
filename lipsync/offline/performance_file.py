"""Performance files, `.perf`: one zip of arrays without pickle, versioned, written whole.

Head and eyes are a member more, which a lipservo that does not know it leaves alone: it plays the
same mouth, and its own head. So version 1 holds for both.
"""

import io
import json
import math
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np
from numpy.lib.npyio import NpzFile
from numpy.typing import NDArray

from lipsync.damaged_archive import UNREADABLE
from lipsync.offline.array_archive import opened
from lipsync.offline.performance import (
    EXPRESSION_NAMES,
    RATE_HZ,
    Performance,
    PerformanceError,
    PerformedSound,
)
from lipsync.output_file import write_whole
from lipsync.phonemes import VISEME_OF, PhonemeEvent

#: Raised whenever the meaning of a stored field changes.
PERFORMANCE_VERSION = 1
#: What such a file is called.
SUFFIX = ".perf"
#: Five minutes of 192 kHz are less; more is no performance.
_MOST_BYTES = 500_000_000
_MOST_DEG = 180.0
_KIND = "lipservo performance"
_ABOUT = "about"
_RENDER_AGAIN = "render it again with `lipservo render`"


def write_performance(performance: Performance, path: Path) -> None:
    """Write a performance whole or not at all. Raises OutputError."""
    write_whole(path, performance_bytes(performance))


def performance_bytes(performance: Performance) -> bytes:
    """The content of its file."""
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
        },
    }
    if performance.expression:
        about["expression"] = list(performance.expression)
    arrays: dict[str, NDArray[Any]] = {
        _ABOUT: np.frombuffer(json.dumps(about).encode(), dtype=np.uint8),
        "coefficients": performance.coefficients.astype(np.float32),
    }
    if sound.content is not None:
        arrays["sound"] = np.frombuffer(sound.content, dtype=np.uint8)
    if performance.expression:
        columns = list(performance.expression.values())
        arrays["expression"] = np.stack(columns, axis=1).astype(np.float32)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    return buffer.getvalue()


def is_performance(head: bytes) -> bool:
    """Whether a file that begins so looks like a performance: what a replaced one must be."""
    return head.startswith(b"PK") and b"about.npy" in head


def read_performance(path: Path) -> Performance:
    """The performance in a file. Raises PerformanceError in one line."""
    content = _content(path)
    try:
        with opened(content) as archive:
            _check_size(content)
            about = json.loads(archive[_ABOUT].tobytes())
            if not isinstance(about, dict) or about.get("kind") != _KIND:
                raise PerformanceError(f"{path}: no performance; {_RENDER_AGAIN}")
            if about["version"] != PERFORMANCE_VERSION or about["rate_hz"] != RATE_HZ:
                raise PerformanceError(
                    f"{path}: performance version {about['version']} at {about['rate_hz']} "
                    f"faces/s, this lipservo plays version {PERFORMANCE_VERSION} at {RATE_HZ:g}; "
                    + _RENDER_AGAIN
                )
            sound = archive["sound"].tobytes() if about["sound"]["included"] else None
            faces = _faces(archive["coefficients"])
            return Performance(
                face_checksum=str(about["face"]),
                coefficients=faces,
                phonemes=tuple(_event(*row) for row in about["phonemes"]),
                sound=PerformedSound(
                    _bare_name(about["sound"]["name"]), str(about["sound"]["sha256"]), sound
                ),
                method=str(about["method"]),
                expression=_expression(about, archive, len(faces)),
            )
    except PerformanceError:
        raise
    except (KeyError, TypeError, IndexError, AttributeError, *UNREADABLE) as error:
        raise PerformanceError(
            f"{path}: damaged or no performance ({error}); {_RENDER_AGAIN}"
        ) from error


def _content(path: Path) -> bytes:
    try:
        # A pipe in its place would be waited for without end.
        if path.exists() and not path.is_file():
            raise PerformanceError(f"{path}: is no file; name one that `lipservo render` wrote")
        if path.stat().st_size > _MOST_BYTES:
            raise PerformanceError(f"{path}: more than {_MOST_BYTES // 10**6} MB: no performance")
        return path.read_bytes()
    except OSError as error:
        raise PerformanceError(f"{path}: cannot be read ({error.strerror})") from error


def _check_size(archive: bytes) -> None:
    """What is packed may be a thousand times larger unpacked."""
    with ZipFile(io.BytesIO(archive)) as file:
        if sum(member.file_size for member in file.infolist()) > _MOST_BYTES:
            raise ValueError(f"more than {_MOST_BYTES // 10**6} MB")


def _expression(
    about: dict[str, Any], archive: NpzFile, n_frames: int
) -> dict[str, NDArray[np.float32]]:
    """Of the names that are known here; those of a later lipservo are left alone."""
    if "expression" not in about:
        return {}
    names, found = list(about["expression"]), archive["expression"]
    if found.shape != (n_frames, len(names)) or not (np.abs(found) <= _MOST_DEG).all():
        raise ValueError(f"expression of shape {found.shape}, or beyond all bounds")
    columns = dict(zip(names, found.astype(np.float32).T, strict=True))
    return {name: columns[name] for name in EXPRESSION_NAMES if name in columns}


def _faces(found: NDArray[Any]) -> NDArray[np.float32]:
    if found.ndim != 2 or not len(found) or not np.isfinite(found).all():
        raise ValueError(f"coefficients of shape {found.shape}, or not all finite")
    return found.astype(np.float32)


def _event(phoneme: str, start_s: float, end_s: float) -> PhonemeEvent:
    if phoneme not in VISEME_OF or not (0.0 <= start_s < end_s < math.inf):
        raise ValueError(f"phoneme {phoneme!r} from {start_s} to {end_s} s")
    return PhonemeEvent(phoneme, float(start_s), float(end_s))


def _bare_name(name: str) -> str:
    """A file's name without folders: what is read lies beside the performance, nowhere else."""
    if not isinstance(name, str) or name in ("", ".", "..") or Path(name).name != name:
        raise ValueError(f"sound name {name!r}")
    return name
