"""The network at run time, in NumPy: causal convolutions over features, as they come.

An entry convolution, residual dilated convolutions (x + relu(W past + b)), one output layer with a
head for each delay: head h, at frame n, gives the posteriors of the phones of frame n - delay.
"""

from dataclasses import dataclass

import numpy as np

from lipsync.arrays import Array32
from lipsync.recognition.features import FeatureScale

#: The committing head: a frame is settled so much later (docs/recognition.md).
LATENCY_S = 0.095
_TAPS = 3
#: Rows of one product of matrices. More cost as much a row (4.5 us at 192 channels), but BLAS then
#: shares the product among threads, and on a computer with other work these wait for each other:
#: 16 rows took 56 ms in place of 0.1 (2 cores, 16 processes, OpenBLAS).
_ROWS = 8


@dataclass(frozen=True, slots=True)
class Layer:
    """A causal convolution: kernel (3 n_in, n_out), oldest tap first; bias (n_out,)."""

    kernel: Array32
    bias: Array32
    dilation: int


@dataclass(frozen=True, slots=True)
class NetworkWeights:
    """All that was learned.

    output: (n_channels, n_heads n_phonemes); delays: frames that each head waits, rising.
    """

    scale: FeatureScale
    entry: Layer
    residuals: tuple[Layer, ...]
    output: Array32
    output_bias: Array32
    delays: tuple[int, ...]
    phonemes: tuple[str, ...]


class StreamingNetwork:
    """Features in, posteriors out; a new one starts from silence.

    A single frame, as live, costs a product of a vector and a matrix a layer. Several frames at
    once cost one product of two matrices a layer, a fraction of that for each frame.
    """

    def __init__(self, weights: NetworkWeights) -> None:
        self._weights = weights
        self._entry = _StreamingLayer(weights.entry)
        self._residuals = [_StreamingLayer(layer) for layer in weights.residuals]

    def push(self, features: Array32) -> Array32:
        """Posteriors (n, n_heads, n_phonemes) of features (n, n_bands)."""
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
    """relu of one convolution; remembers as many inputs as its kernel reaches back."""

    def __init__(self, layer: Layer) -> None:
        self._layer = layer
        self._n_past = (_TAPS - 1) * layer.dilation
        # A ring of the last inputs, the present one among them.
        self._past = np.zeros((self._n_past + 1, len(layer.kernel) // _TAPS), np.float32)
        self._taps = np.empty(len(layer.kernel), np.float32)
        self._newest = 0

    def step(self, frame: Array32) -> Array32:
        """(n_in,) to (n_out,)."""
        n_ring, n_in = self._past.shape
        self._newest = (self._newest + 1) % n_ring
        self._past[self._newest] = frame
        for tap in range(_TAPS):
            age = (_TAPS - 1 - tap) * self._layer.dilation
            self._taps[tap * n_in : (tap + 1) * n_in] = self._past[(self._newest - age) % n_ring]
        output: Array32 = self._taps @ self._layer.kernel + self._layer.bias
        return np.maximum(output, np.float32(0.0), out=output)

    def push(self, frames: Array32) -> Array32:
        """(n, n_in) to (n, n_out)."""
        n, dilation = len(frames), self._layer.dilation
        in_order = np.roll(self._past, -1 - self._newest, axis=0)
        known = np.concatenate((in_order, frames))
        taps = [known[1 + tap * dilation :][:n] for tap in range(_TAPS)]
        product = _product(np.concatenate(taps, axis=1), self._layer.kernel)
        output: Array32 = product + self._layer.bias
        self._past = known[n:].copy()
        self._newest = self._n_past
        return np.maximum(output, np.float32(0.0), out=output)


def _product(rows: Array32, matrix: Array32) -> Array32:
    """`rows @ matrix`, (n, n_in) by (n_in, n_out), a few rows at a time."""
    n = len(rows)
    padded = np.zeros((-(-n // _ROWS) * _ROWS, rows.shape[1]), np.float32)
    padded[:n] = rows
    product: Array32 = (padded.reshape(-1, _ROWS, rows.shape[1]) @ matrix).reshape(len(padded), -1)
    return product[:n]


def _posteriors(logits: Array32, weights: NetworkWeights) -> Array32:
    by_head = logits.reshape(len(logits), len(weights.delays), len(weights.phonemes))
    powers = np.exp(by_head - by_head.max(axis=2, keepdims=True))
    posteriors: Array32 = powers / powers.sum(axis=2, keepdims=True)
    return posteriors
