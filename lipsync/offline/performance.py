"""A performance: a line ready to be played, its sound and the faces that belong to it."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from lipsync.errors import UserError
from lipsync.face.model import FaceModel
from lipsync.phonemes import PhonemeEvent

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
    """A performance that cannot be played: says which, why, and what to do."""


@dataclass(frozen=True, slots=True)
class PerformedSound:
    """The sound of a performance, byte for byte the file it was rendered from.

    name: of that file, without folders. sha256: of its bytes, 64 hex digits. content: the bytes
    that are to be written into the performance file; None where the file stays beside it, and of
    every performance that was read: `performance_file.sound_file` has them then.
    """

    name: str
    sha256: str
    content: bytes | None


def performed_sound(path: Path, *, included: bool) -> PerformedSound:
    """The sound of a file. Raises PerformanceError where it cannot be read."""
    try:
        content = path.read_bytes()
    except OSError as error:
        raise PerformanceError(f"{path}: cannot be read ({error.strerror})") from error
    digest = hashlib.sha256(content).hexdigest()
    return PerformedSound(path.name, digest, content if included else None)


@dataclass(frozen=True, slots=True)
class Performance:
    """A rendered line; it serves every face that is calibrated for its face model.

    face_checksum: of that model. coefficients: (n, n_components) float32, frame i at i / 100 s of
    sound time. phonemes: in order, each with its end. method: how it was rendered. expression: of
    some `EXPRESSION_NAMES` the values (n,) float32 at the same times, in units of `Expression`;
    empty: head and eyes are left to the face that plays it.
    """

    face_checksum: str
    coefficients: NDArray[np.float32]
    phonemes: tuple[PhonemeEvent, ...]
    sound: PerformedSound
    method: str
    expression: Mapping[str, NDArray[np.float32]] = field(default_factory=dict)

    @property
    def duration_s(self) -> float:
        """From the first face to the last."""
        return (len(self.coefficients) - 1) / RATE_HZ

    def check_face(self, face: FaceModel, name: str) -> None:
        """Raises PerformanceError for a face of another model than this was rendered for."""
        if face.checksum != self.face_checksum:
            raise PerformanceError(
                f"{name}: rendered for face model {self.face_checksum}, this face is "
                f"{face.checksum}; render it again with `lipservo lines render --model`"
            )
        if self.coefficients.shape[1] != face.n_components:
            raise PerformanceError(
                f"{name}: damaged: {self.coefficients.shape[1]} coefficients a face, its model has "
                f"{face.n_components}; render it again with `lipservo lines render`"
            )
