"""The recogniser's network in torch, for training: made, loaded with weights, exported."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from lipservo_lab.learning.recognition.training_data import (
    TrainingArray,
    TrainingError,
    TrainingPlan,
    draw_windows,
)
from lipsync.phonemes import PHONEMES
from lipsync.recognition.features import N_BANDS, FeatureScale
from lipsync.recognition.network import Layer, NetworkWeights

#: Windows from which the norms of a network that goes on from other weights are set.
_NORM_WINDOWS = 64
#: Size of a new layer's initial weights, as a share of the usual: at first it adds next to nothing;
#: with zeros it would never learn.
_ADDED_SHARE = 0.003


class _Residual(nn.Module):
    """x + relu(norm(conv(x))), causal."""

    def __init__(self, channels: int, dilation: int) -> None:
        super().__init__()
        self.conv = nn.Conv1d(channels, channels, 3, dilation=dilation, bias=False)
        self.norm = nn.BatchNorm1d(channels)
        self.padding = 2 * dilation

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return the input plus the output of the block, (b, channels, n)."""
        return x + torch.relu(self.norm(self.conv(nn.functional.pad(x, (self.padding, 0)))))


class TorchNetwork(nn.Module):
    """The network as torch trains it: features (b, 40, n) to logits (b, n_heads, 40 phones, n)."""

    def __init__(self, plan: TrainingPlan) -> None:
        super().__init__()
        self.n_heads = len(plan.delays)
        self.entry = nn.Conv1d(N_BANDS, plan.channels, 3)
        self.body = nn.Sequential(*(_Residual(plan.channels, d) for d in plan.dilations))
        self.exit = nn.Conv1d(plan.channels, self.n_heads * len(PHONEMES), 1)

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """Return logits (b, n_heads, 40 phones, n) of features (b, 40, n)."""
        logits = self.exit(self.body(torch.relu(self.entry(nn.functional.pad(x, (2, 0))))))
        return logits.unflatten(1, (self.n_heads, len(PHONEMES)))


def exported(network: nn.Module, scale: FeatureScale, plan: TrainingPlan) -> NetworkWeights:
    """Return the network's weights for NumPy, with batch norms folded into the convolutions."""
    assert isinstance(network, TorchNetwork)
    layers = [Layer(_kernel(network.entry.weight), _numpy(network.entry.bias), 1)]
    for block, dilation in zip(network.body, plan.dilations, strict=True):
        assert isinstance(block, _Residual)
        norm = block.norm
        gain = norm.weight / torch.sqrt(norm.running_var + norm.eps)
        bias = norm.bias - gain * norm.running_mean
        layers.append(
            Layer(_kernel(block.conv.weight * gain[:, None, None]), _numpy(bias), dilation)
        )
    return NetworkWeights(
        scale=scale,
        entry=layers[0],
        residuals=tuple(layers[1:]),
        output=_numpy(network.exit.weight[:, :, 0].T),
        output_bias=_numpy(network.exit.bias),
        delays=plan.delays,
        phonemes=PHONEMES,
    )


def started_from(
    weights: NetworkWeights, arrays: Sequence[TrainingArray], plan: TrainingPlan
) -> TorchNetwork:
    """Return a network with the outputs of `weights`, ready for further training.

    Weights of a smaller network are grown to the plan's size. Batch norms are folded into the
    weights; here new norms get the means and variances of what the layers give on windows of the
    arrays, and such scales that the network's outputs do not change.

    Parameters
    ----------
    weights : NetworkWeights
        To start from.
    arrays : Sequence[TrainingArray]
        Features of shape (n_frames, 40), and targets.
    plan : TrainingPlan
        Shape and seed.

    Returns
    -------
    TorchNetwork
        Of the plan's shape.
    """
    weights = grown(weights, plan)
    network = TorchNetwork(plan)
    layers = [weights.entry, *weights.residuals]
    rng = np.random.default_rng([plan.seed, plan.n_steps])
    norm_plan = replace(plan, batch=_NORM_WINDOWS)
    hidden = torch.from_numpy(draw_windows(arrays, norm_plan, rng)[0])
    with torch.no_grad():
        network.entry.weight.copy_(_torch_kernel(layers[0].kernel))
        network.entry.bias.copy_(torch.from_numpy(layers[0].bias))
        hidden = torch.relu(network.entry(nn.functional.pad(hidden, (2, 0))))
        for block, layer in zip(network.body, layers[1:], strict=True):
            assert isinstance(block, _Residual)
            block.conv.weight.copy_(_torch_kernel(layer.kernel))
            convolved = block.conv(nn.functional.pad(hidden, (block.padding, 0)))
            mean, variance = convolved.mean(dim=(0, 2)), convolved.var(dim=(0, 2))
            block.norm.running_mean.copy_(mean)
            block.norm.running_var.copy_(variance)
            block.norm.weight.copy_(torch.sqrt(variance + block.norm.eps))
            block.norm.bias.copy_(torch.from_numpy(layer.bias) + mean)
            hidden = hidden + torch.relu(convolved + torch.from_numpy(layer.bias)[:, None])
        network.exit.weight.copy_(torch.from_numpy(weights.output.T[:, :, None]))
        network.exit.bias.copy_(torch.from_numpy(weights.output_bias))
    return network


def grown(weights: NetworkWeights, plan: TrainingPlan) -> NetworkWeights:
    """Return weights grown to the plan's number of channels and layers.

    No old weight reads a new channel, and new layers add next to nothing, so that the network's
    outputs stay nearly the same and it can learn more (the idea is Net2Net's: Chen, Goodfellow and
    Shlens, ICLR 2016). Raises TrainingError for a plan that is narrower or shorter, or has other
    dilations or delays.
    """
    dilations = tuple(layer.dilation for layer in weights.residuals)
    channels, n_old = len(weights.entry.bias), len(dilations)
    is_larger = plan.channels >= channels and plan.dilations[:n_old] == dilations
    if not is_larger or weights.delays != plan.delays:
        raise TrainingError(
            "the weights to start from do not fit: a network may only "
            f"grow from {channels} channels, dilations {','.join(map(str, dilations))} (more may "
            f"follow) and delays {','.join(map(str, weights.delays))}"
        )
    if (plan.channels, plan.dilations) == (channels, dilations):
        return weights
    rng = np.random.default_rng(plan.seed)

    def widened(layer: Layer, n_in: int) -> Layer:
        """Return a layer of `plan.channels` outputs that computes the old ones as before.

        Old outputs ignore the new inputs; new outputs begin with random weights. n_in: inputs of
        the new layer.
        """
        old_in = len(layer.kernel) // 3
        kernel = np.zeros((3, n_in, plan.channels), np.float32)
        kernel[:, :old_in, :channels] = layer.kernel.reshape(3, old_in, channels)
        spread = np.sqrt(1.0 / (3 * n_in))
        kernel[:, :, channels:] = spread * rng.standard_normal((3, n_in, plan.channels - channels))
        bias = np.zeros(plan.channels, np.float32)
        bias[:channels] = layer.bias
        return Layer(kernel.reshape(3 * n_in, plan.channels), bias, layer.dilation)

    def added(dilation: int) -> Layer:
        """Return a new layer with small random weights."""
        spread = _ADDED_SHARE * np.sqrt(1.0 / (3 * plan.channels))
        kernel = spread * rng.standard_normal((3 * plan.channels, plan.channels))
        return Layer(kernel.astype(np.float32), np.zeros(plan.channels, np.float32), dilation)

    output = np.zeros((plan.channels, weights.output.shape[1]), np.float32)
    output[:channels] = weights.output
    return replace(
        weights,
        entry=widened(weights.entry, N_BANDS),
        residuals=(
            *(widened(layer, plan.channels) for layer in weights.residuals),
            *(added(dilation) for dilation in plan.dilations[n_old:]),
        ),
        output=output,
    )


def _kernel(weight: torch.Tensor) -> NDArray[np.float32]:
    """Return a kernel (out, in, 3 taps) of torch as (3 taps x in, out), for NumPy."""
    return _numpy(weight.permute(2, 1, 0).flatten(0, 1))


def _torch_kernel(kernel: NDArray[np.float32]) -> torch.Tensor:
    """Return a kernel (3 taps x in, out) as (out, in, 3 taps): the inverse of `_kernel`."""
    taps = torch.from_numpy(kernel).unflatten(0, (3, -1))
    return taps.permute(2, 1, 0)


def _numpy(tensor: torch.Tensor) -> NDArray[np.float32]:
    return np.ascontiguousarray(tensor.detach().cpu().numpy(), dtype=np.float32)
