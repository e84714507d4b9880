"""The mean of weights and the weights that their training started from.

Both mostly lie in one valley of the loss, so that the mean has learned what is new and keeps what
was known: Wortsman and others, "Robust fine-tuning of zero-shot models", CVPR 2022, equation 1.
"""

from dataclasses import replace

import numpy as np

from lipsync.arrays import Array32
from lipsync.recognition.network import Layer, NetworkWeights


def averaged(learned: NetworkWeights, start: NetworkWeights, start_share: float) -> NetworkWeights:
    """Return the weighted mean of two networks' weights; `start` has the share `start_share`.

    learned: was trained from `start`, so both have the same shape.
    """

    def mean(one: Array32, other: Array32) -> Array32:
        share = np.float32(start_share)
        return np.asarray((1 - share) * one + share * other, np.float32)

    def mean_layer(one: Layer, other: Layer) -> Layer:
        kernel, bias = mean(one.kernel, other.kernel), mean(one.bias, other.bias)
        return Layer(kernel, bias, one.dilation)

    residuals = zip(learned.residuals, start.residuals, strict=True)
    return replace(
        learned,
        entry=mean_layer(learned.entry, start.entry),
        residuals=tuple(mean_layer(one, other) for one, other in residuals),
        output=mean(learned.output, start.output),
        output_bias=mean(learned.output_bias, start.output_bias),
    )
