"""Training a small network with two hidden layers of rectifiers, by Adam, in NumPy.

Squared error, weight decay as part of the gradient, a learning rate that falls to zero over the
second half. Kingma and Ba, "Adam", ICLR 2015, algorithm 1; initial weights: Glorot and Bengio,
AISTATS 2010, eq. (16).
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array32 = NDArray[np.float32]

_BATCH = 800
_LEARNING_RATE = 2e-3
#: Kingma and Ba's own.
_BETA_1, _BETA_2, _EPSILON = 0.9, 0.999, 1e-8


@dataclass(frozen=True, slots=True)
class Schedule:
    """How long and how strictly to train.

    decay: what every weight is pulled by, in units of itself, beside the mean gradient of a batch.
    """

    n_epochs: int
    decay: float


Layers = list[Array32]


def initial_layers(sizes: tuple[int, ...], rng: np.random.Generator) -> Layers:
    """Weights (n_in, n_out) and bias (n_out,) of each layer, alternating."""
    layers: Layers = []
    for n_in, n_out in pairwise(sizes):
        bound = np.sqrt(6.0 / (n_in + n_out))
        layers.append(rng.uniform(-bound, bound, (n_in, n_out)).astype(np.float32))
        layers.append(np.zeros(n_out, dtype=np.float32))
    return layers


def forward(layers: Layers, inputs: Array32) -> list[Array32]:
    """The inputs, and what every layer makes of them; the last one is linear."""
    values = [inputs]
    n_layers = len(layers) // 2
    for i in range(n_layers):
        value = values[-1] @ layers[2 * i] + layers[2 * i + 1]
        values.append(np.maximum(value, 0.0, out=value) if i < n_layers - 1 else value)
    return values


def gradients(layers: Layers, inputs: Array32, targets: Array32) -> Layers:
    """Of half the squared error, summed over outputs and averaged over the batch."""
    values = forward(layers, inputs)
    slope = (values[-1] - targets) / np.float32(len(inputs))
    found: Layers = []
    for i in reversed(range(len(layers) // 2)):
        found += [slope.sum(axis=0), values[i].T @ slope]
        if i:
            slope = (slope @ layers[2 * i].T) * (values[i] > 0.0)
    return found[::-1]


def fit(
    layers: Layers, inputs: Array32, targets: Array32, schedule: Schedule, rng: np.random.Generator
) -> Layers:
    """Train in place, and return the layers."""
    first = [np.zeros_like(layer) for layer in layers]
    second = [np.zeros_like(layer) for layer in layers]
    n_batches = -(-len(inputs) // _BATCH)
    n_steps, step = schedule.n_epochs * n_batches, 0
    for _ in range(schedule.n_epochs):
        for batch in np.array_split(rng.permutation(len(inputs)), n_batches):
            slopes = gradients(layers, inputs[batch], targets[batch])
            step += 1
            rate = _LEARNING_RATE * min(1.0, 2.0 * (1.0 - (step - 1) / n_steps))
            rate *= np.sqrt(1.0 - _BETA_2**step) / (1.0 - _BETA_1**step)
            for layer, slope, m, v in zip(layers, slopes, first, second, strict=True):
                if layer.ndim == 2:
                    slope += np.float32(schedule.decay) * layer
                m *= _BETA_1
                m += (1.0 - _BETA_1) * slope
                v *= _BETA_2
                v += (1.0 - _BETA_2) * slope * slope
                layer -= np.float32(rate) * m / (np.sqrt(v) + _EPSILON)
    return layers
