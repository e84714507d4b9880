"""The trained face: basis, AnimPhos, and the two tables that say what follows and what fits.

Data only. One `.npz` without pickle; float32 on disk, float64 in the arithmetic.
"""

import hashlib
import io
import json
import zipfile
import zlib
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lipsync.baselines.dominance import Dominance
from lipsync.baselines.regression import PlainRegression
from lipsync.errors import UserError
from lipsync.expectation.expectation import Expectation, expectation_of
from lipsync.face.index_lists import IndexLists
from lipsync.markers import LOWER_INNER_LIP, UPPER_INNER_LIP
from lipsync.output_file import write_whole
from lipsync.phonemes import PHONEMES

Array = NDArray[np.float64]
Indices = NDArray[np.int64]

#: Raised whenever the meaning of a stored field changes; older files are refused, not guessed at.
MODEL_VERSION = 3
SAMPLES_PER_ANIMPHO = 5
#: What reading a damaged archive raises, by where the damage is.
_UNREADABLE = (
    OSError,
    ValueError,
    EOFError,
    RuntimeError,
    MemoryError,
    zlib.error,
    zipfile.BadZipFile,
)
SHIPPED_MODEL = "grid_s1"


class ModelError(UserError):
    """A model file that cannot be used: says which, why, and what to do."""


@dataclass(frozen=True, slots=True)
class FaceModel:
    """One talker's mouth.

    marker_names: n_markers names; mean_mm (n_markers, 3); basis (n_components, 3 n_markers), rows
    orthonormal; head_reference_mm (n_rigid, 3), the pose that all motion was fitted to.
    rest: (n_components,), the closed mouth of silence.
    animphos: (m, 5, n_components). successors: T of the paper, `successors[i]` = T(a_i).
    phoneme_table: L of the paper, a row for each of `PHONEMES`.
    expectation: what the live method plays. covariance: (n_components, n_components), of the face
    in speech. labiodental_gap_mm: how near the inner lips come in F and V, the recordings' median.
    tightest_s: (40,), when after its onset the lips are nearest in P B M F V, the median; else 0.
    centres: (40, n_components), the mean middle of each of `PHONEMES`, and counts (40,), of how
    many; dominance, regression: the rivals that evaluation compares with.
    """

    marker_names: tuple[str, ...]
    mean_mm: Array
    basis: Array
    head_reference_mm: Array
    rest: Array
    animphos: Array
    successors: IndexLists
    predecessors: IndexLists
    phoneme_table: IndexLists
    training_sentences: tuple[str, ...]
    provenance: dict[str, str | int | float]
    expectation: Expectation
    covariance: Array
    labiodental_gap_mm: float
    tightest_s: Array
    centres: Array
    counts: Array
    dominance: Dominance
    regression: PlainRegression

    @property
    def n_components(self) -> int:
        """Number of principal components."""
        return len(self.basis)

    @property
    def known_phonemes(self) -> frozenset[str]:
        """The phonemes that training heard; others are played by a stand-in."""
        return frozenset(p for i, p in enumerate(PHONEMES) if len(self.phoneme_table[i]))

    @property
    def mean_successors(self) -> float:
        """How many AnimPhos follow one on average; the paper: 3.45."""
        return len(self.successors.indices) / len(self.animphos)

    def of_phoneme(self, phoneme: str) -> Indices:
        """L(p): the AnimPhos of a phoneme."""
        return self.phoneme_table[PHONEMES.index(phoneme)]

    def coefficients(self, markers_mm: NDArray[np.floating]) -> Array:
        """(n_frames, n_markers, 3) -> (n_frames, n_components)."""
        flat = (markers_mm - self.mean_mm).reshape(len(markers_mm), -1)
        return np.asarray(flat @ self.basis.T, dtype=np.float64)

    def markers_mm(self, coefficients: Array) -> Array:
        """(n_frames, n_components) -> (n_frames, n_markers, 3)."""
        return self.mean_mm + (coefficients @ self.basis).reshape(-1, *self.mean_mm.shape)

    def lip_gap_mm(self, coefficients: Array) -> float:
        """Distance between the middle points of the inner lips for one frame (n_components,)."""
        basis = self.basis.reshape(self.n_components, -1, 3)
        upper = self.mean_mm[UPPER_INNER_LIP] + coefficients @ basis[:, UPPER_INNER_LIP]
        lower = self.mean_mm[LOWER_INNER_LIP] + coefficients @ basis[:, LOWER_INNER_LIP]
        return float(np.linalg.norm(upper - lower))

    @property
    def checksum(self) -> str:
        """16 hex digits over what a calibration depends on: marker names, mean face, basis."""
        digest = hashlib.sha256("\n".join(self.marker_names).encode())
        for array in (self.mean_mm, self.basis):
            digest.update(np.ascontiguousarray(array, dtype="<f4").tobytes())
        return digest.hexdigest()[:16]


def save_model(model: FaceModel, path: Path) -> None:
    """Write the model whole or not at all. Raises OutputError."""
    about = {
        "version": MODEL_VERSION,
        "marker_names": model.marker_names,
        "phonemes": PHONEMES,
        "training_sentences": model.training_sentences,
        "provenance": model.provenance,
    }
    arrays: dict[str, NDArray[np.generic]] = dict(
        about=np.frombuffer(json.dumps(about).encode(), dtype=np.uint8),
        mean_mm=model.mean_mm.astype(np.float32),
        basis=model.basis.astype(np.float32),
        head_reference_mm=model.head_reference_mm.astype(np.float32),
        rest=model.rest.astype(np.float32),
        animphos=model.animphos.astype(np.float32),
        successor_starts=model.successors.starts.astype(np.int32),
        successors=model.successors.indices.astype(np.int32),
        phoneme_starts=model.phoneme_table.starts.astype(np.int32),
        phoneme_animphos=model.phoneme_table.indices.astype(np.int32),
        **{
            f"expectation_{name}": values.astype(np.float32)
            for name, values in model.expectation.arrays().items()
        },
        covariance=model.covariance.astype(np.float32),
        labiodental_gap_mm=np.array(model.labiodental_gap_mm, dtype=np.float32),
        tightest_s=model.tightest_s.astype(np.float32),
        centres=model.centres.astype(np.float32),
        counts=model.counts.astype(np.float32),
        dominance=np.stack([model.dominance.rates_per_s, model.dominance.powers]),
        regression=model.regression.weights.astype(np.float32),
    )
    buffer = io.BytesIO()
    np.savez_compressed(buffer, allow_pickle=False, **arrays)
    write_whole(path, buffer.getvalue())


def is_model(head: bytes) -> bool:
    """Whether a file that begins so looks like a model: a zip archive that begins with `about`."""
    return head.startswith(b"PK") and b"about.npy" in head


def load_model(path: Path) -> FaceModel:
    """Read a model file. Raises ModelError for a missing, damaged or foreign file."""
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise ModelError(f"{path}: no such model file; train one with `lipservo train`") from None
    except OSError as error:
        raise ModelError(f"{path}: cannot be read: {error.strerror}") from error
    return _parse(content, str(path))


def load_shipped_model(name: str = SHIPPED_MODEL) -> FaceModel:
    """The model that comes with the package."""
    file = resources.files("lipsync.models") / f"{name}.npz"
    try:
        return _parse(file.read_bytes(), f"shipped model {name}")
    except FileNotFoundError:
        raise ModelError(f"no shipped model {name!r}; reinstall lipservo") from None


def _parse(content: bytes, name: str) -> FaceModel:
    damaged = f"{name}: damaged or not a lipservo model; get a fresh copy or train one again"
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as file:
            arrays = {key: file[key] for key in file.files}
        about = json.loads(arrays["about"].tobytes())
        version = about["version"]
    except (KeyError, TypeError, *_UNREADABLE) as error:
        raise ModelError(damaged) from error
    if version != MODEL_VERSION:
        raise ModelError(
            f"{name}: model version {version}, this lipservo reads version {MODEL_VERSION}; "
            "train it again with `lipservo train`"
        )
    try:
        model = _assemble(about, arrays)
        _check(model)
    except (KeyError, ValueError, TypeError, IndexError) as error:
        raise ModelError(f"{damaged} ({error})") from error
    return model


def _assemble(about: dict[str, object], arrays: dict[str, NDArray[np.generic]]) -> FaceModel:
    def floats(key: str) -> Array:
        return np.asarray(arrays[key], dtype=np.float64)

    def lists(starts: str, indices: str) -> IndexLists:
        return IndexLists(arrays[starts].astype(np.int64), arrays[indices].astype(np.int64))

    if about["phonemes"] != list(PHONEMES):
        raise ValueError("its phoneme inventory differs")
    successors = lists("successor_starts", "successors")
    names, sentences = about["marker_names"], about["training_sentences"]
    provenance = about["provenance"]
    if not (isinstance(names, list) and isinstance(sentences, list)):
        raise TypeError("names are missing")
    if not isinstance(provenance, dict):
        raise TypeError("provenance is missing")
    return FaceModel(
        marker_names=tuple(names),
        mean_mm=floats("mean_mm"),
        basis=floats("basis"),
        head_reference_mm=floats("head_reference_mm"),
        rest=floats("rest"),
        animphos=floats("animphos"),
        successors=successors,
        predecessors=successors.transposed(len(arrays["animphos"])),
        phoneme_table=lists("phoneme_starts", "phoneme_animphos"),
        training_sentences=tuple(sentences),
        provenance=provenance,
        expectation=expectation_of(
            {
                key.removeprefix("expectation_"): floats(key)
                for key in arrays
                if key.startswith("expectation_")
            }
        ),
        covariance=floats("covariance"),
        labiodental_gap_mm=float(arrays["labiodental_gap_mm"]),
        tightest_s=floats("tightest_s"),
        centres=floats("centres"),
        counts=floats("counts"),
        dominance=Dominance(*floats("dominance")),
        regression=PlainRegression(floats("regression")),
    )


def _check(model: FaceModel) -> None:
    """Shapes agree and every number is finite; raises ValueError naming the field that is wrong."""
    n_markers, n_components, m = len(model.marker_names), model.n_components, len(model.animphos)
    shapes = {
        "mean_mm": (model.mean_mm.shape, (n_markers, 3)),
        "basis": (model.basis.shape, (n_components, 3 * n_markers)),
        "rest": (model.rest.shape, (n_components,)),
        "animphos": (model.animphos.shape, (m, SAMPLES_PER_ANIMPHO, n_components)),
        "successors": ((len(model.successors),), (m,)),
        "phoneme_table": ((len(model.phoneme_table),), (len(PHONEMES),)),
        "covariance": (model.covariance.shape, (n_components, n_components)),
        "centres": (model.centres.shape, (len(PHONEMES), n_components)),
    }
    for field, (found, expected) in shapes.items():
        if found != expected:
            raise ValueError(f"{field} has shape {found}, expected {expected}")
    model.expectation.check(n_components)
    for field in ("mean_mm", "basis", "rest", "animphos", "covariance", "centres"):
        if not np.isfinite(getattr(model, field)).all():
            raise ValueError(f"{field} holds values that are not finite")
    for lists in (model.successors, model.phoneme_table):
        ends_right = lists.starts[0] == 0 and lists.starts[-1] == len(lists.indices)
        if not ends_right or (np.diff(lists.starts) < 0).any():
            raise ValueError("a table's rows are out of order")
        if len(lists.indices) and not 0 <= lists.indices.min() <= lists.indices.max() < m:
            raise ValueError("a table points outside the AnimPhos")
    if m == 0 or not model.known_phonemes:
        raise ValueError("it holds no AnimPhos")
