"""A recogniser's network with random weights: it hears nonsense, but as exactly as any other."""

import numpy as np

from lipsync.phonemes import PHONEMES
from lipsync.recognition.features import N_BANDS, FeatureScale
from lipsync.recognition.network import Layer, NetworkWeights


def random_weights(n_channels=16, dilations=(1, 2, 4), delays=(2, 7, 12), seed=0):
    rng = np.random.default_rng(seed)

    def layer(n_in, dilation):
        kernel = rng.standard_normal((3 * n_in, n_channels)).astype(np.float32)
        bias = rng.standard_normal(n_channels).astype(np.float32)
        return Layer(kernel / np.float32(np.sqrt(3 * n_in)), bias, dilation)

    n_outputs = len(delays) * len(PHONEMES)
    return NetworkWeights(
        scale=FeatureScale(np.full(N_BANDS, -4, np.float32), np.full(N_BANDS, 3, np.float32)),
        entry=layer(N_BANDS, 1),
        residuals=tuple(layer(n_channels, dilation) for dilation in dilations),
        output=rng.standard_normal((n_channels, n_outputs)).astype(np.float32),
        output_bias=rng.standard_normal(n_outputs).astype(np.float32),
        delays=delays,
        phonemes=PHONEMES,
    )
