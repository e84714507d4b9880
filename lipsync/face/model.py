"""The face of one speaker: mean, principal components, the closed mouth and its lips' statistics.

It is one part of a model file: one `.npz` without pickle, of which each reader loads only its own
part. The data that move a face are other parts: AnimPhos (recorded pieces of motion), the
expectation (which predicts mean motion), the baselines. A member of the archive is called
`PART/ARRAY`. `about` comes first and describes the file in JSON. Nothing of a part is read before
it is used.
"""

import hashlib
import io
import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from lipsync.array_archive import UNREADABLE, ArrayArchive, about_in
from lipsync.arrays import Array
from lipsync.errors import UserError
from lipsync.markers import PointLayout, layout_of
from lipsync.output_file import write_whole
from lipsync.phonemes import PHONEMES

Arrays = Mapping[str, NDArray[np.generic]]
Part = TypeVar("Part")

#: Raised whenever the meaning of a stored field changes; files of other versions are refused.
MODEL_VERSION = 4
SHIPPED_MODEL = "grid_s1"
#: Thirty times the shipped one, unpacked.
_MOST_BYTES = 64_000_000
_ABOUT = "about"
_TRAIN_AGAIN = "train it again with `lipservo learn face`"


class ModelError(UserError):
    """Error for a model file that cannot be used: which, why, and what to do."""


class ModelFile:
    """An open model file, of which single parts are read.

    name: the file's name, for error messages. about: the file's description of itself, parsed JSON.
    layout: the points of its face.
    """

    def __init__(self, name: str, archive: ArrayArchive) -> None:
        """Read and check the header of an open archive.

        Raises ModelError if the header is damaged or of another version or inventory of phonemes.
        """
        self.name = name
        self._archive = archive
        try:
            self.about: dict[str, Any] = json.loads(archive[_ABOUT].tobytes())
            version = self.about["version"]
        except (KeyError, TypeError, *UNREADABLE) as error:
            raise self._damaged_error() from error
        if version != MODEL_VERSION:
            raise ModelError(
                f"{name}: model version {version}, this lipservo reads version {MODEL_VERSION}; "
                + _TRAIN_AGAIN
            )
        try:
            if self.about["phonemes"] != list(PHONEMES):
                raise ValueError("the model's phonemes are not those of this lipservo version")
            self.layout: PointLayout = layout_of(self.about["layout"])
        except (KeyError, TypeError, ValueError, AttributeError, UserError) as error:
            raise self._damaged_error(error) from error

    def read(self, part: str, assemble: Callable[[Arrays], Part]) -> Part:
        """Read a part of the file.

        Parameters
        ----------
        part : str
            Name of the part.
        assemble : Callable[[Arrays], Part]
            Makes the part from its arrays, which it gets by name, in the shape that was written.

        Returns
        -------
        Part
            The result of `assemble`.

        Raises
        ------
        ModelError
            The part is missing or damaged, or `assemble` raises KeyError, ValueError, TypeError or
            IndexError.
        """
        prefix = f"{part}/"
        names = [name for name in self._archive.names if name.startswith(prefix)]
        if not names:
            raise ModelError(f"{self.name}: its part {part!r} is missing; {_TRAIN_AGAIN}")
        try:
            return assemble({name.removeprefix(prefix): self._archive[name] for name in names})
        except ModelError:
            raise
        except (KeyError, TypeError, IndexError, *UNREADABLE) as error:
            raise self._damaged_error(error) from error

    def has(self, part: str) -> bool:
        """Return whether the file contains the part of this name."""
        return any(name.startswith(f"{part}/") for name in self._archive.names)

    def _damaged_error(self, error: Exception | None = None) -> ModelError:
        why = f" ({error})" if error is not None else ""
        return ModelError(
            f"{self.name}: damaged or not a lipservo model; get a fresh copy or train one again"
            + why
        )


@contextmanager
def open_model(path: Path | None = None) -> Iterator[ModelFile]:
    """Open the model file at `path`, as a context manager; None: the shipped file.

    Raises ModelError for a file that is missing, damaged, foreign or of another version.
    """
    name = f"shipped model {SHIPPED_MODEL}" if path is None else str(path)
    place = resources.files("lipsync.models") / f"{SHIPPED_MODEL}.npz" if path is None else path
    with ExitStack() as stack:
        try:
            stream = stack.enter_context(place.open("rb"))
        except FileNotFoundError:
            remedy = (
                "reinstall lipservo" if path is None else "train one with `lipservo learn face`"
            )
            raise ModelError(f"{name}: no such model file; {remedy}") from None
        except OSError as error:
            raise ModelError(f"{name}: cannot be read: {error.strerror}") from error
        try:
            archive = stack.enter_context(ArrayArchive(stream, _MOST_BYTES))
        except UNREADABLE as error:
            raise ModelError(
                f"{name}: damaged or not a lipservo model ({error}); get it anew or train one"
            ) from error
        yield ModelFile(name, archive)


def write_model(
    path: Path, layout: PointLayout, about: Mapping[str, object], parts: Mapping[str, Arrays]
) -> None:
    """Write a model file whole or not at all: an error leaves an existing file as it was.

    Parameters
    ----------
    path : Path
        File to write, replaced if it exists.
    layout : PointLayout
        The points of the face.
    about : Mapping[str, object]
        Further entries of the header.
    parts : Mapping[str, Arrays]
        By the part's name, arrays of any shape by name.

    Raises
    ------
    OutputError
        The file cannot be written.
    """
    header = {
        "version": MODEL_VERSION,
        "layout": layout.description(),
        "phonemes": PHONEMES,
        **about,
    }
    arrays: dict[str, NDArray[np.generic]] = {
        _ABOUT: np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    }
    for part, members in parts.items():
        arrays |= {f"{part}/{name}": values for name, values in members.items()}
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    write_whole(path, buffer.getvalue())


def is_model(head: bytes) -> bool:
    """Return whether a file's first bytes are those of a face model."""
    about = about_in(head)
    return b'"layout"' in about and b'"kind"' not in about


#: The part of a model file that holds a face.
FACE_PART = "face"
_ARRAYS = (
    "mean_mm", "basis", "head_reference_mm", "rest", "covariance", "labiodental_gap_mm",
    "tightest_s",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class FaceModel:
    """The mouth of one speaker: mean face, principal components and statistics of the lips.

    layout: the points that the face has. mean_mm (n_points, 3); basis (n_components, 3 n_points),
    rows orthonormal; head_reference_mm (n_rigid, 3), the pose that all motion was fitted to. rest:
    (n_components,), the closed mouth of silence. covariance: (n_components, n_components), of the
    face in speech. tightest_s: (40,), seconds from the onset until the lips are nearest in P B M F
    V, the recordings' median; else 0. labiodental_gap_mm: how far the inner lips are apart then in
    F and V, the mean.
    """

    layout: PointLayout
    mean_mm: Array
    basis: Array
    head_reference_mm: Array
    rest: Array
    covariance: Array
    labiodental_gap_mm: float
    tightest_s: Array

    @property
    def n_components(self) -> int:
        """The number of principal components of the face."""
        return len(self.basis)

    def coefficients(self, markers_mm: NDArray[np.floating]) -> Array:
        """Return the coefficients (of the principal components) of marker positions.

        Parameters
        ----------
        markers_mm : NDArray[np.floating]
            (n_frames, n_points, 3) positions in mm.

        Returns
        -------
        Array
            (n_frames, n_components) coefficients.
        """
        flat = (markers_mm - self.mean_mm).reshape(len(markers_mm), -1)
        return np.asarray(flat @ self.basis.T, dtype=np.float64)

    def markers_mm(self, coefficients: Array) -> Array:
        """Return the marker positions of faces that are given as coefficients.

        Parameters
        ----------
        coefficients : Array
            (n_frames, n_components) coefficients.

        Returns
        -------
        Array
            (n_frames, n_points, 3) mm.
        """
        return self.mean_mm + (coefficients @ self.basis).reshape(-1, *self.mean_mm.shape)

    @property
    def lips_touching_mm(self) -> Array:
        """The vector from lower to upper point of the lip gap when the lips touch.

        0 where these points lie on the inner lips. On outer lips it is the height of both lips:
        that of the mouth at rest.

        Returns
        -------
        Array
            (3,) mm.
        """
        if self.layout.has_inner_lips:
            return np.zeros(3)
        at_rest_mm = self.layout.gap_vectors_mm(self.markers_mm(self.rest[None]))
        return np.asarray(at_rest_mm[0], dtype=np.float64)

    def lip_gap_mm(self, coefficients: Array) -> float:
        """Return how far the lips are apart in one frame.

        Parameters
        ----------
        coefficients : Array
            (n_components,) coefficients.

        Returns
        -------
        float
            mm, 0 where the lips touch.
        """
        basis = self.basis.reshape(self.n_components, -1, 3)
        upper_point, lower_point = self.layout.upper_lip, self.layout.lower_lip
        upper = self.mean_mm[upper_point] + coefficients @ basis[:, upper_point]
        lower = self.mean_mm[lower_point] + coefficients @ basis[:, lower_point]
        return float(np.linalg.norm(upper - lower - self.lips_touching_mm))

    def lip_gaps_mm(self, markers_mm: NDArray[np.floating]) -> Array:
        """Return how far the lips are apart in each frame.

        Parameters
        ----------
        markers_mm : NDArray[np.floating]
            (n_frames, n_points, 3) positions in mm.

        Returns
        -------
        Array
            (n_frames,) mm, 0 where the lips touch.
        """
        vectors_mm = self.layout.gap_vectors_mm(markers_mm)
        if not self.layout.has_inner_lips:
            vectors_mm = vectors_mm - self.lips_touching_mm
        return np.asarray(np.linalg.norm(vectors_mm, axis=1), dtype=np.float64)

    @property
    def checksum(self) -> str:
        """16 hex digits over all that a calibration depends on: point names, mean face, basis."""
        digest = hashlib.sha256("\n".join(self.layout.names).encode())
        for array in (self.mean_mm, self.basis):
            digest.update(np.ascontiguousarray(array, dtype="<f4").tobytes())
        return digest.hexdigest()[:16]


def load_face(path: Path | None = None) -> FaceModel:
    """Return the face alone of a model file; `path` None: the shipped file. Raises ModelError."""
    with open_model(path) as file:
        return read_face(file)


def read_face(file: ModelFile) -> FaceModel:
    """Return the face of an open model file. Raises ModelError if it is missing or damaged."""

    def assemble(arrays: Mapping[str, NDArray[np.generic]]) -> FaceModel:
        floats = {name: np.asarray(arrays[name], dtype=np.float64) for name in _ARRAYS}
        gap_mm = float(floats.pop("labiodental_gap_mm"))
        face = FaceModel(layout=file.layout, labiodental_gap_mm=gap_mm, **floats)
        _check_face(face)
        return face

    return file.read(FACE_PART, assemble)


def face_arrays(face: FaceModel) -> dict[str, NDArray[np.generic]]:
    """Return the arrays that a model file stores for a face.

    Parameters
    ----------
    face : FaceModel
        The face to store.

    Returns
    -------
    dict[str, NDArray[np.generic]]
        By name, float32, in the shape of the fields.
    """
    return {name: np.asarray(getattr(face, name), dtype=np.float32) for name in _ARRAYS}


def _check_face(face: FaceModel) -> None:
    """Raise ValueError, naming the field, unless all shapes agree and every number is finite."""
    n_points, n_components = face.layout.n_points, face.n_components
    shapes = {
        "mean_mm": (n_points, 3),
        "basis": (n_components, 3 * n_points),
        "rest": (n_components,),
        "covariance": (n_components, n_components),
        "tightest_s": (len(PHONEMES),),
    }
    for field, expected in shapes.items():
        values = getattr(face, field)
        if values.shape != expected:
            raise ValueError(f"array {field} has shape {values.shape}, expected {expected}")
        if not np.isfinite(values).all():
            raise ValueError(f"array {field} has values that are not finite")
    if not np.isfinite(face.labiodental_gap_mm):
        raise ValueError("array labiodental_gap_mm has values that are not finite")
