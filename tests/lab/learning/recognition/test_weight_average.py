"""The mean of weights, array by array."""

from dataclasses import replace

import numpy as np
import pytest
from lipservo_lab.learning.recognition.weight_average import averaged

from lipsync.recognition.network import load_shipped_weights

START = load_shipped_weights()


def moved(by):
    """The same weights, every number of them further by so much."""
    layers = [
        replace(layer, kernel=layer.kernel + by, bias=layer.bias + by)
        for layer in (START.entry, *START.residuals)
    ]
    output, bias = START.output + by, START.output_bias + by
    return replace(
        START, entry=layers[0], residuals=tuple(layers[1:]), output=output, output_bias=bias
    )


def arrays(weights):
    layers = [
        array for each in (weights.entry, *weights.residuals) for array in (each.kernel, each.bias)
    ]
    return [*layers, weights.output, weights.output_bias]


@pytest.mark.slow
@pytest.mark.parametrize("start_share", [0.0, 0.3, 1.0])
def test_every_array_lies_between_in_proportion(start_share):
    mean = averaged(moved(np.float32(0.5)), START, start_share)
    for between, start in zip(arrays(mean), arrays(START), strict=True):
        assert between - start == pytest.approx(0.5 * (1.0 - start_share), abs=1e-5)
        assert between.dtype == np.float32
    assert mean.delays == START.delays
    assert [layer.dilation for layer in mean.residuals] == [x.dilation for x in START.residuals]
