"""AnimPhos, recorded pieces of mouth motion (Wei and Deng), and which may follow which.

Each is the motion of one phoneme, as five samples.

The paper's tables of zeros and ones are `IndexLists`: the AnimPhos that follow each AnimPho, and
the AnimPhos of each phoneme.

`in_layout` gives a face at other points than it was trained with: robots are calibrated at 47 named
markers. A model of more points has them among its own; where one has no inner lips, they are
assumed to move with the outer ones: a lip keeps its thickness, and both meet half-way between the
outer lips when the mouth is at rest.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array
from lipsync.face.model import FaceModel, ModelFile, open_model, read_face
from lipsync.markers import LayoutError, PointLayout
from lipsync.phonemes import PHONEMES

Indices = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class IndexLists:
    """Lists of indices, one for each of n rows, stored end to end: a table of zeros and ones.

    starts: (n + 1,), where each row begins in `indices`; indices: (starts[-1],), the columns with a
    1, ascending within a row.
    """

    starts: Indices
    indices: Indices

    @classmethod
    def from_pairs(cls, rows: Indices, columns: Indices, n_rows: int) -> "IndexLists":
        """Return the lists of a table of `n_rows` rows with a 1 at each pair (row, column).

        Duplicates are merged.
        """
        pairs = np.unique(np.stack([rows, columns], axis=1), axis=0).astype(np.int64)
        starts = np.searchsorted(pairs[:, 0], np.arange(n_rows + 1)).astype(np.int64)
        return cls(starts, np.ascontiguousarray(pairs[:, 1]))

    def __len__(self) -> int:
        return len(self.starts) - 1

    def __getitem__(self, row: int) -> Indices:
        return self.indices[self.starts[row] : self.starts[row + 1]]

    def transposed(self, n_rows: int) -> "IndexLists":
        """Return the table with rows and columns swapped; `n_rows`: the new number of rows."""
        return IndexLists.from_pairs(self.indices, self.rows(), n_rows)

    def rows(self) -> Indices:
        """Return the row number of every stored index, shape (len(indices),)."""
        return np.repeat(np.arange(len(self)), np.diff(self.starts))


#: The part of a model file that holds AnimPhos.
ANIMPHO_PART = "animphos"
SAMPLES_PER_ANIMPHO = 5


@dataclass(frozen=True, slots=True)
class AnimPhoUnits:
    """All AnimPhos (recorded pieces of mouth motion) of a speaker and the paper's two tables.

    rest: (n_components,), the closed mouth, from which a chain of AnimPhos begins. samples: (m, 5,
    n_components). successors: T of the paper, `successors[i]` = T(a_i). predecessors: `successors`
    transposed. phoneme_table: L of the paper, a row for each of `PHONEMES`.
    """

    rest: Array
    samples: Array
    successors: IndexLists
    predecessors: IndexLists
    phoneme_table: IndexLists

    def __len__(self) -> int:
        return len(self.samples)

    @property
    def known_phonemes(self) -> frozenset[str]:
        """The phonemes that have AnimPhos, as they occurred in training; others need a stand-in."""
        return frozenset(p for i, p in enumerate(PHONEMES) if len(self.phoneme_table[i]))

    @property
    def mean_successors(self) -> float:
        """The mean number of AnimPhos that may follow an AnimPho; 3.45 in the paper."""
        return len(self.successors.indices) / len(self.samples)

    @property
    def frames(self) -> Array:
        """Every sample of every AnimPho (recorded piece of motion): the faces that occur in speech.

        Returns
        -------
        Array
            Face coefficients, shape (5 m, n_components).
        """
        return self.samples.reshape(-1, self.samples.shape[2])

    def of_phoneme(self, phoneme: str) -> Indices:
        """Return L(p): the indices of the AnimPhos of `phoneme`; empty if training had none."""
        return self.phoneme_table[PHONEMES.index(phoneme)]


@dataclass(frozen=True, slots=True)
class FaceWithAnimPhos(FaceModel):
    """A face model and the AnimPhos of its speaker; a robot's calibration is fitted to both."""

    animphos: AnimPhoUnits


def load_face_with_animphos(path: Path | None = None) -> FaceWithAnimPhos:
    """Return face and AnimPhos of a model file; `path` None: the shipped one. Raises ModelError."""
    with open_model(path) as file:
        face = read_face(file)
        return FaceWithAnimPhos(**face_fields(face), animphos=read_animphos(file, face))


def face_fields(face: FaceModel) -> dict[str, Any]:
    """Return the field values of a `FaceModel` by name, to build an instance of a subclass."""
    return {field.name: getattr(face, field.name) for field in fields(FaceModel)}


def read_animphos(file: ModelFile, face: FaceModel) -> AnimPhoUnits:
    """Return the AnimPhos, recorded pieces of motion of one phoneme each, of an open model file.

    face: the face model of the same file; only its number of components is checked. Raises
    ModelError if the AnimPhos are missing or damaged, or have another number of components.
    """

    def assemble(arrays: Mapping[str, NDArray[np.generic]]) -> AnimPhoUnits:
        """Build the AnimPhos from the file's arrays, by name; ValueError if these are damaged."""
        samples = np.asarray(arrays["samples"], dtype=np.float64)
        successors = _index_lists(arrays["successor_starts"], arrays["successors"])
        phoneme_table = _index_lists(arrays["phoneme_starts"], arrays["phoneme_animphos"])
        _check_animphos(samples, successors, phoneme_table, face.n_components)
        return AnimPhoUnits(
            face.rest, samples, successors, successors.transposed(len(samples)), phoneme_table
        )

    return file.read(ANIMPHO_PART, assemble)


def animpho_arrays(units: AnimPhoUnits) -> dict[str, NDArray[np.generic]]:
    """Return the arrays that a model file stores for AnimPhos (recorded pieces of motion).

    The closed mouth, `rest`, is not among them: the face's part of the file holds it.

    Parameters
    ----------
    units : AnimPhoUnits
        m AnimPhos.

    Returns
    -------
    dict[str, NDArray[np.generic]]
        By name; `samples` has shape (m, 5, n_components).
    """
    return {
        "samples": units.samples.astype(np.float32),
        "successor_starts": units.successors.starts.astype(np.int32),
        "successors": units.successors.indices.astype(np.int32),
        "phoneme_starts": units.phoneme_table.starts.astype(np.int32),
        "phoneme_animphos": units.phoneme_table.indices.astype(np.int32),
    }


def _index_lists(starts: NDArray[np.generic], indices: NDArray[np.generic]) -> IndexLists:
    return IndexLists(starts.astype(np.int64), indices.astype(np.int64))


def _check_animphos(
    samples: Array, successors: IndexLists, phoneme_table: IndexLists, n_components: int
) -> None:
    """Raise ValueError unless tables and samples fit together and all samples are finite."""
    m = len(samples)
    if samples.shape != (m, SAMPLES_PER_ANIMPHO, n_components):
        raise ValueError(
            f"samples have shape {samples.shape}, expected {(m, SAMPLES_PER_ANIMPHO, n_components)}"
        )
    if not np.isfinite(samples).all():
        raise ValueError("samples have values that are not finite")
    for lists, n_rows in ((successors, m), (phoneme_table, len(PHONEMES))):
        if len(lists) != n_rows:
            raise ValueError(f"the file's table of AnimPhos has {len(lists)} rows, not {n_rows}")
        covers_all = lists.starts[0] == 0 and lists.starts[-1] == len(lists.indices)
        if not covers_all or (np.diff(lists.starts) < 0).any():
            raise ValueError("its table of AnimPhos (recorded pieces) has rows out of order")
        if len(lists.indices) and not 0 <= lists.indices.min() <= lists.indices.max() < m:
            raise ValueError(f"its table names a piece of motion beyond the {m} that it has")
    if m == 0 or not len(phoneme_table.indices):
        raise ValueError("the file has no AnimPhos (recorded pieces of motion)")


#: For each point of the inner lips the outer one that it moves with, and the one opposite to it.
_OUTER_OF_INNER = {
    78: (61, 61), 308: (291, 291),
    82: (37, 84), 13: (0, 17), 312: (267, 314),
    87: (84, 37), 14: (17, 0), 317: (314, 267),
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class FaceInOtherLayout(FaceWithAnimPhos):
    """A face model at another layout's points; its coefficients and AnimPhos are unchanged.

    The rows of its basis are no longer orthonormal: it can compute markers from coefficients, but
    no coefficients from markers. own_checksum: checksum of the original model.
    """

    own_checksum: str

    @property
    def checksum(self) -> str:
        """Checksum of the model from which this one was derived."""
        return self.own_checksum


def in_layout(model: FaceWithAnimPhos, layout: PointLayout) -> FaceWithAnimPhos:
    """Return the model with the points of another layout; `model` itself if it has these already.

    A point of the inner lips that the model lacks lies, at rest, half-way between two opposite
    points of the outer lips, and moves with the nearer one. Raises LayoutError for any other point
    that the model lacks.
    """
    if model.layout == layout:
        return model
    basis = model.basis.reshape(model.n_components, -1, 3)
    rest_mm = model.markers_mm(model.rest[None])[0]
    index_of = {landmark: i for i, landmark in enumerate(model.layout.landmarks)}
    means, rows = [], []
    for landmark in layout.landmarks:
        mean_mm = model.mean_mm[index_of[landmark]] if landmark in index_of else None
        moves_with = landmark
        if mean_mm is None:
            moves_with, opposite = _OUTER_OF_INNER.get(landmark, (landmark, landmark))
            if not {moves_with, opposite} <= set(index_of):
                raise LayoutError(
                    f"landmark {landmark} is unknown in a model of {model.layout.name}; train one "
                    f"by `lipservo learn face --markers {layout.n_points}`"
                )
            thickness_mm = (rest_mm[index_of[opposite]] - rest_mm[index_of[moves_with]]) / 2.0
            mean_mm = model.mean_mm[index_of[moves_with]] + thickness_mm
        means.append(mean_mm)
        rows.append(basis[:, index_of[moves_with]])
    fields = face_fields(model) | {
        "layout": layout,
        "mean_mm": np.array(means),
        "basis": np.stack(rows, axis=1).reshape(model.n_components, -1),
    }
    return FaceInOtherLayout(**fields, animphos=model.animphos, own_checksum=model.checksum)
