"""The recogniser's neural network at run time, in NumPy: causal convolutions over live features.

An entry convolution, residual dilated convolutions (x + relu(W past + b)), one output layer with a
head for each delay: head h, at frame n, gives the phones' posteriors of frame n - delays[h].

Its weights are one .npz of float16 arrays, never pickle.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lipsync.array_archive import UNREADABLE, ArrayArchive, arrays_of
from lipsync.arrays import Array32
from lipsync.errors import UserError
from lipsync.output_file import written_whole
from lipsync.phonemes import PHONEMES
from lipsync.recognition.features import N_BANDS, FeatureScale

#: The committing head: a frame is settled so much later (docs/recognition.md).
LATENCY_S = 0.095
_TAPS = 3
#: Key of the provenance: the digest of the weights that adaptation began with.
ADAPTED_FROM = "adapted_from"
#: Rows of one product of matrices. With more, a row costs as much (4.5 us at 192 channels), but
#: BLAS shares the product among threads, which wait for each other on a busy computer: 16 rows took
#: 56 ms in place of 0.1 (2 cores, 16 processes, OpenBLAS).
_ROWS = 8


@dataclass(frozen=True, slots=True)
class Layer:
    """A causal convolution, three taps: kernel (3 n_in, n_out), oldest first; bias (n_out,)."""

    kernel: Array32
    bias: Array32
    dilation: int


@dataclass(frozen=True, slots=True)
class NetworkWeights:
    """All learned weights of the network.

    scale: of its features. output: (n_channels, n_heads n_phonemes); delays: frames that each head
    waits, rising; phonemes: names in the order of the outputs.
    """

    scale: FeatureScale
    entry: Layer
    residuals: tuple[Layer, ...]
    output: Array32
    output_bias: Array32
    delays: tuple[int, ...]
    phonemes: tuple[str, ...]


class StreamingNetwork:
    """The network on a live stream: features in, posteriors out; a new one starts from silence.

    A single frame, as live, costs a product of a vector and a matrix a layer. Several frames at
    once cost one product of two matrices a layer, a fraction of that for each frame.
    """

    def __init__(self, weights: NetworkWeights) -> None:
        self._weights = weights
        self._entry = _StreamingLayer(weights.entry)
        self._residuals = [_StreamingLayer(layer) for layer in weights.residuals]

    def push(self, features: Array32) -> Array32:
        """Return the phoneme posteriors for the next frames of features.

        Parameters
        ----------
        features : Array32
            (n, n_bands).

        Returns
        -------
        Array32
            (n, n_heads, n_phonemes).
        """
        weights = self._weights
        if len(features) == 1:
            hidden = self._entry.step(features[0])
            for layer in self._residuals:
                hidden = hidden + layer.step(hidden)
            logits = (hidden @ weights.output + weights.output_bias)[None]
        else:
            hidden = self._entry.push(features)
            for layer in self._residuals:
                hidden = hidden + layer.push(hidden)
            logits = _product(hidden, weights.output) + weights.output_bias
        return _posteriors(logits, weights)


class _StreamingLayer:
    """One convolution with relu on a stream; it stores the past inputs that its kernel needs."""

    def __init__(self, layer: Layer) -> None:
        """Create the layer with a past of zeros."""
        self._layer = layer
        self._n_past = (_TAPS - 1) * layer.dilation
        # Ring of the last inputs, the present one among them, (n_past + 1, n_in).
        self._past = np.zeros((self._n_past + 1, len(layer.kernel) // _TAPS), np.float32)
        self._inputs = np.empty(len(layer.kernel), np.float32)
        self._newest = 0

    def step(self, frame: Array32) -> Array32:
        """Return the layer's output (n_out,) for the next frame (n_in,)."""
        n_ring, n_in = self._past.shape
        self._newest = (self._newest + 1) % n_ring
        self._past[self._newest] = frame
        for tap in range(_TAPS):
            age = (_TAPS - 1 - tap) * self._layer.dilation
            self._inputs[tap * n_in : (tap + 1) * n_in] = self._past[(self._newest - age) % n_ring]
        output: Array32 = self._inputs @ self._layer.kernel + self._layer.bias
        return np.maximum(output, np.float32(0.0), out=output)

    def push(self, frames: Array32) -> Array32:
        """Return the layer's outputs (n, n_out) for the next frames (n, n_in)."""
        # One row of three inputs side by side for each frame, then one product for all.
        n, dilation = len(frames), self._layer.dilation
        past_and_new = np.concatenate((np.roll(self._past, -1 - self._newest, axis=0), frames))
        taps = [past_and_new[1 + tap * dilation :][:n] for tap in range(_TAPS)]
        product = _product(np.concatenate(taps, axis=1), self._layer.kernel)
        output: Array32 = product + self._layer.bias
        self._past = past_and_new[n:].copy()
        self._newest = self._n_past
        return np.maximum(output, np.float32(0.0), out=output)


def _product(rows: Array32, matrix: Array32) -> Array32:
    """Return `rows @ matrix`, (n, n_in) by (n_in, n_out), computed a few rows at a time."""
    n = len(rows)
    padded = np.zeros((-(-n // _ROWS) * _ROWS, rows.shape[1]), np.float32)
    padded[:n] = rows
    product: Array32 = (padded.reshape(-1, _ROWS, rows.shape[1]) @ matrix).reshape(len(padded), -1)
    return product[:n]


def _posteriors(logits: Array32, weights: NetworkWeights) -> Array32:
    """Return each head's softmax (n, n_heads, n_phonemes) of logits (n, n_heads n_phonemes)."""
    by_head = logits.reshape(len(logits), len(weights.delays), len(weights.phonemes))
    powers = np.exp(by_head - by_head.max(axis=2, keepdims=True))
    posteriors: Array32 = powers / powers.sum(axis=2, keepdims=True)
    return posteriors


_FORMAT = 1
#: Thirty times the shipped ones, unpacked.
_MOST_BYTES = 64_000_000
DEFAULT_WEIGHTS = "default"
#: The weights that come with the package, by name.
SHIPPED = {DEFAULT_WEIGHTS: "recognizer.npz", "grid": "recognizer_grid.npz"}


class WeightsError(UserError):
    """Error for a weights file that cannot be used; the message is one line: which, why, remedy."""


def save_weights(
    weights: NetworkWeights,
    path: str | PathLike[str],
    provenance: Mapping[str, object] | None = None,
) -> None:
    """Write the network's weights to the file `path`, whole or not at all. Raises OutputError.

    Half precision changes posteriors by less than 0.01 (tested). provenance: origin of the weights,
    stored in the file as JSON (`provenance`); of it only `ADAPTED_FROM` is read again.
    """
    layers = (weights.entry, *weights.residuals)
    arrays: dict[str, NDArray[np.generic]] = {
        "format": np.array(_FORMAT),
        "phonemes": np.array(weights.phonemes),
        "delays": np.array(weights.delays),
        "dilations": np.array([layer.dilation for layer in layers]),
        "scale_mean": weights.scale.mean.astype(np.float32),
        "scale_deviation": weights.scale.deviation.astype(np.float32),
        "output": weights.output.astype(np.float16),
        "output_bias": weights.output_bias.astype(np.float32),
    }
    for index, layer in enumerate(layers):
        arrays[f"kernel_{index}"] = layer.kernel.astype(np.float16)
        arrays[f"bias_{index}"] = layer.bias.astype(np.float32)
    if provenance is not None:
        arrays["provenance"] = np.array(json.dumps(provenance))
    with written_whole(Path(path)) as partial, partial.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **arrays)


def is_weights(head: bytes) -> bool:
    """Return whether a file's first bytes are of a zip with `format.npy`, as weights files are."""
    return head.startswith(b"PK") and b"format.npy" in head


def load_weights(path: str | PathLike[str]) -> NetworkWeights:
    """Return the weights in a file; raise WeightsError if missing, damaged or inconsistent."""
    try:
        with Path(path).open("rb") as file:
            arrays = arrays_of(file, _MOST_BYTES)
    except FileNotFoundError as error:
        raise WeightsError(f"{path}: no such file; check the path") from error
    except UNREADABLE as error:
        raise WeightsError(f"{path}: damaged or no weights; copy or train them again") from error
    try:
        version = int(arrays["format"])
        weights = _build_weights(arrays) if version == _FORMAT else None
    except KeyError as error:
        raise WeightsError(f"{path}: not weights of a recogniser: {error} is missing") from error
    except (ValueError, TypeError, IndexError) as error:  # no layers, text for numbers
        raise WeightsError(f"{path}: not weights of a recogniser; train them again") from error
    if weights is None:
        raise WeightsError(
            f"{path}: weights of format {version}, this lipservo reads format {_FORMAT}; update "
            "lipservo, or train them again"
        )
    if inconsistency := _inconsistency(weights):
        raise WeightsError(f"{path}: {inconsistency}; copy or train it again")
    return weights


def load_shipped_weights(name: str = DEFAULT_WEIGHTS) -> NetworkWeights:
    """Return the weights `name` of the package; raise WeightsError if missing or damaged."""
    with resources.as_file(resources.files("lipsync.models") / SHIPPED[name]) as path:
        return load_weights(path)


def find_weights(name_or_path: str) -> NetworkWeights:
    """Return shipped weights by name, or a file's; raise WeightsError if neither is usable."""
    _check_name(name_or_path)
    if name_or_path in SHIPPED:
        return load_shipped_weights(name_or_path)
    return load_weights(name_or_path)


def weights_digest(name_or_path: str) -> str:
    """Return 16 hex digits of the SHA-256 of a weights file, or of shipped weights by name.

    Raises WeightsError if there is no such file, or it is unreadable.
    """
    _check_name(name_or_path)
    shipped = SHIPPED.get(name_or_path)
    file = Path(name_or_path) if shipped is None else resources.files("lipsync.models") / shipped
    try:
        return hashlib.sha256(file.read_bytes()).hexdigest()[:16]
    except OSError as error:
        raise WeightsError(f"{name_or_path}: cannot be read: {error.strerror}") from error


def adapted_from(name_or_path: str) -> str | None:
    """Return the digest of the weights that a file's weights were adapted from.

    None for shipped weights, for weights trained from scratch, and for an unreadable file.
    """
    if name_or_path in SHIPPED:
        return None
    try:
        with Path(name_or_path).open("rb") as file, ArrayArchive(file, _MOST_BYTES) as archive:
            return str(json.loads(str(archive["provenance"]))[ADAPTED_FROM])
    except (*UNREADABLE, KeyError, TypeError):
        return None


def check_weights(name_or_path: str) -> None:
    """Raise WeightsError unless `name_or_path` is of shipped weights or of a usable weights file.

    The default weights are not read: where they are damaged a lesser recogniser replaces them.
    Other weights are loaded to check them.
    """
    if name_or_path != DEFAULT_WEIGHTS:
        find_weights(name_or_path)


def _check_name(name_or_path: str) -> None:
    if name_or_path not in SHIPPED and not Path(name_or_path).is_file():
        raise WeightsError(
            f"{name_or_path}: no such file; give another, or shipped weights: {', '.join(SHIPPED)}"
        )


def _build_weights(arrays: dict[str, NDArray[np.generic]]) -> NetworkWeights:
    """Build the weights from a file's arrays; consistency is checked by `_inconsistency`.

    Raises KeyError, ValueError, TypeError or IndexError for arrays that are missing or unusable.
    """
    dilations = [int(dilation) for dilation in arrays["dilations"]]
    layers = [
        Layer(_float(arrays[f"kernel_{i}"]), _float(arrays[f"bias_{i}"]), dilation)
        for i, dilation in enumerate(dilations)
    ]
    return NetworkWeights(
        scale=FeatureScale(_float(arrays["scale_mean"]), _float(arrays["scale_deviation"])),
        entry=layers[0],
        residuals=tuple(layers[1:]),
        output=_float(arrays["output"]),
        output_bias=_float(arrays["output_bias"]),
        delays=tuple(int(delay) for delay in arrays["delays"]),
        phonemes=tuple(str(phoneme) for phoneme in arrays["phonemes"]),
    )


def _float(array: NDArray[np.generic]) -> NDArray[np.float32]:
    return np.ascontiguousarray(array, dtype=np.float32)


def _inconsistency(weights: NetworkWeights) -> str:
    """Return the first inconsistency of the weights, in words; "" if there is none."""
    n_channels = len(weights.entry.bias)
    n_outputs = len(weights.delays) * len(weights.phonemes)
    shapes: list[tuple[NDArray[np.float32], tuple[int, ...]]] = [
        (weights.entry.kernel, (3 * N_BANDS, n_channels))
    ]
    shapes += [(layer.kernel, (3 * n_channels, n_channels)) for layer in weights.residuals]
    shapes += [(layer.bias, (n_channels,)) for layer in weights.residuals]
    shapes += [(weights.output, (n_channels, n_outputs)), (weights.output_bias, (n_outputs,))]
    shapes += [(weights.scale.mean, (N_BANDS,)), (weights.scale.deviation, (N_BANDS,))]
    for array, shape in shapes:
        if array.shape != shape:
            return f"an array has the shape {array.shape} where {shape} is needed"
        if not np.isfinite(array).all():
            return "has values that are not finite"
    if weights.phonemes != PHONEMES:
        return "was made for other phonemes"
    if not weights.delays or list(weights.delays) != sorted(set(weights.delays)):
        return "its heads are out of order"
    return ""
