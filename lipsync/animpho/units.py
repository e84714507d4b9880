"""AnimPhos, the animation units of Wei and Deng: five frames each, and what follows what."""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lipsync.animpho.index_lists import IndexLists
from lipsync.arrays import Array
from lipsync.face.model import FaceModel, read_face
from lipsync.face.model_file import ModelFile, open_model
from lipsync.phonemes import PHONEMES

Indices = NDArray[np.int64]

#: The part of a model file that holds AnimPhos.
ANIMPHO_PART = "animphos"
SAMPLES_PER_ANIMPHO = 5


@dataclass(frozen=True, slots=True)
class AnimPhoUnits:
    """All AnimPhos of a speaker and the paper's two tables.

    rest: (n_components,), the closed mouth, out of which a chain of AnimPhos begins.
    samples: (m, 5, n_components). successors: T of the paper, `successors[i]` = T(a_i).
    phoneme_table: L of the paper, a row for each of `PHONEMES`.
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
        """The phonemes that training heard; others are played by a stand-in."""
        return frozenset(p for i, p in enumerate(PHONEMES) if len(self.phoneme_table[i]))

    @property
    def mean_successors(self) -> float:
        """How many AnimPhos follow one on average; the paper: 3.45."""
        return len(self.successors.indices) / len(self.samples)

    @property
    def frames(self) -> Array:
        """(5 m, n_components), every sample of every AnimPho: faces that speech makes."""
        return self.samples.reshape(-1, self.samples.shape[2])

    def of_phoneme(self, phoneme: str) -> Indices:
        """L(p): the AnimPhos of a phoneme."""
        return self.phoneme_table[PHONEMES.index(phoneme)]


@dataclass(frozen=True, slots=True)
class FaceWithAnimPhos(FaceModel):
    """A face and the AnimPhos of the same speaker: what a calibration is fitted to."""

    animphos: AnimPhoUnits


def load_face_with_animphos(path: Path | None = None) -> FaceWithAnimPhos:
    """Both parts of a model file; None: the shipped one. Raises ModelError."""
    with open_model(path) as file:
        face = read_face(file)
        return FaceWithAnimPhos(**face_fields(face), animphos=read_animphos(file, face))


def face_fields(face: FaceModel) -> dict[str, Any]:
    """What a face is made of, to make one of with more to it."""
    return {field.name: getattr(face, field.name) for field in fields(FaceModel)}


def read_animphos(file: ModelFile, face: FaceModel) -> AnimPhoUnits:
    """The AnimPhos of an open model file, for its face. Raises ModelError."""

    def assemble(arrays: Mapping[str, NDArray[np.generic]]) -> AnimPhoUnits:
        samples = np.asarray(arrays["samples"], dtype=np.float64)
        successors = _lists(arrays["successor_starts"], arrays["successors"])
        phoneme_table = _lists(arrays["phoneme_starts"], arrays["phoneme_animphos"])
        _check(samples, successors, phoneme_table, face.n_components)
        return AnimPhoUnits(
            face.rest, samples, successors, successors.transposed(len(samples)), phoneme_table
        )

    return file.read(ANIMPHO_PART, assemble)


def animpho_arrays(units: AnimPhoUnits) -> dict[str, NDArray[np.generic]]:
    """What a file keeps of AnimPhos; the rest pose is the face's."""
    return {
        "samples": units.samples.astype(np.float32),
        "successor_starts": units.successors.starts.astype(np.int32),
        "successors": units.successors.indices.astype(np.int32),
        "phoneme_starts": units.phoneme_table.starts.astype(np.int32),
        "phoneme_animphos": units.phoneme_table.indices.astype(np.int32),
    }


def _lists(starts: NDArray[np.generic], indices: NDArray[np.generic]) -> IndexLists:
    return IndexLists(starts.astype(np.int64), indices.astype(np.int64))


def _check(
    samples: Array, successors: IndexLists, phoneme_table: IndexLists, n_components: int
) -> None:
    """Raises ValueError unless tables and samples fit together."""
    m = len(samples)
    if samples.shape != (m, SAMPLES_PER_ANIMPHO, n_components):
        raise ValueError(
            f"samples has shape {samples.shape}, expected {(m, SAMPLES_PER_ANIMPHO, n_components)}"
        )
    if not np.isfinite(samples).all():
        raise ValueError("samples holds values that are not finite")
    for lists, n_rows in ((successors, m), (phoneme_table, len(PHONEMES))):
        if len(lists) != n_rows:
            raise ValueError(f"a table has {len(lists)} rows, expected {n_rows}")
        ends_right = lists.starts[0] == 0 and lists.starts[-1] == len(lists.indices)
        if not ends_right or (np.diff(lists.starts) < 0).any():
            raise ValueError("a table's rows are out of order")
        if len(lists.indices) and not 0 <= lists.indices.min() <= lists.indices.max() < m:
            raise ValueError("a table points outside the AnimPhos")
    if m == 0 or not len(phoneme_table.indices):
        raise ValueError("it holds no AnimPhos")
