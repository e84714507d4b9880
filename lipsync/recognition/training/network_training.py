"""Learning the network's weights with torch (extra `train`); nothing here is needed to run.

Random windows of the training arrays, cross entropy of phones and of viseme classes for every
head, AdamW under a cosine schedule, a running average of the weights. Every step draws its windows
from (seed, step), so that a run that was interrupted goes on exactly as it would have.
"""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from lipsync.errors import UserError
from lipsync.output_file import written_whole
from lipsync.phonemes import PHONEMES, VISEME_CLASSES, VISEME_OF
from lipsync.recognition.features import N_BANDS, FeatureScale
from lipsync.recognition.network import Layer, NetworkWeights
from lipsync.recognition.training.training_data import NO_TARGET, TrainingArray

#: Chance that one of the light copies' windows is drawn; the heavy ones share the rest.
_LIGHT_SHARE = 0.25
_MASKED_BANDS = 8
#: Windows from which the norms of a network that goes on from other weights are set.
_NORM_WINDOWS = 64
_N_VISEMES = len(VISEME_CLASSES)


@dataclass(frozen=True, slots=True)
class TrainingPlan:
    """How to learn; the defaults are those of `lipservo train-recognizer`."""

    delays: tuple[int, ...] = (2, 7, 12)
    head_weights: tuple[float, ...] = (0.3, 0.5, 0.2)
    dilations: tuple[int, ...] = (1, 2, 4, 8, 1, 2, 4, 8)
    channels: int = 192
    n_steps: int = 5_000
    batch: int = 32
    window: int = 400
    peak_rate: float = 3e-3
    weight_decay: float = 0.02
    seed: int = 0
    n_threads: int = 2
    log_every: int = 50
    check_every: int = 250

    @property
    def averaging(self) -> float:
        """Share of the running average that stays at each step: it spans a quarter of the run."""
        return 1.0 - 4.0 / max(8, self.n_steps)


class _Residual(nn.Module):
    """x + relu(norm(conv(x))), causal."""

    def __init__(self, channels: int, dilation: int) -> None:
        super().__init__()
        self.conv = nn.Conv1d(channels, channels, 3, dilation=dilation, bias=False)
        self.norm = nn.BatchNorm1d(channels)
        self.padding = 2 * dilation

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """(b, channels, n) to the same."""
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
        """See the class."""
        logits = self.exit(self.body(torch.relu(self.entry(nn.functional.pad(x, (2, 0))))))
        return logits.unflatten(1, (self.n_heads, len(PHONEMES)))


class TrainingError(UserError):
    """There is nothing to learn from, or the parts do not fit; the message is one line."""


Checkpoint = Callable[[int, NetworkWeights], Mapping[str, float]]


def train_network(
    arrays: Sequence[TrainingArray],
    scale: FeatureScale,
    plan: TrainingPlan,
    *,
    folder: Path,
    start: NetworkWeights | None = None,
    check: Checkpoint = lambda _step, _weights: {},
    progress: Callable[[int], None] = lambda _step: None,
) -> NetworkWeights:
    """Learn from arrays (the first one is the light copy); returns the averaged weights.

    `folder` keeps the state (`state.pt`) and the run log (`log.jsonl`): a run that finds a state
    there goes on from it. `start`: weights to begin with in place of random ones. `check` scores
    the weights so far; its figures go into the log. Raises TrainingError where `start` is of
    another shape than the plan's.
    """
    torch.manual_seed(plan.seed)
    torch.set_num_threads(plan.n_threads)
    network = TorchNetwork(plan) if start is None else started_from(start, arrays, plan)
    average = torch.optim.swa_utils.AveragedModel(
        network,
        multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(plan.averaging),
        use_buffers=True,
    )
    optimizer = torch.optim.AdamW(network.parameters(), weight_decay=plan.weight_decay)
    first = _resume(folder / "state.pt", network, average, optimizer)
    with (folder / "log.jsonl").open("a", encoding="utf-8") as log:
        losses: list[float] = []
        for step in range(first, plan.n_steps):
            losses.append(_learn(network, optimizer, arrays, plan, step))
            average.update_parameters(network)
            progress(step + 1)
            is_last = step + 1 == plan.n_steps
            if (step + 1) % plan.log_every == 0 or is_last:
                record: dict[str, float] = {"step": step + 1, "loss": float(np.mean(losses))}
                losses.clear()
                if (step + 1) % plan.check_every == 0 or is_last:
                    weights = exported(average.module, scale, plan)
                    record |= check(step + 1, weights)
                    _save(folder / "state.pt", step + 1, network, average, optimizer)
                log.write(json.dumps(record) + "\n")
                log.flush()
    return exported(average.module, scale, plan)


def exported(network: nn.Module, scale: FeatureScale, plan: TrainingPlan) -> NetworkWeights:
    """The weights for NumPy: batch norm folded into the convolutions."""
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
    """A network that says what `weights` say, ready to go on learning.

    The weights hold no norms, these are folded into them; they are set here from what the layers
    give on windows of the arrays, so that the first step finds the network as it was left.
    """
    network = TorchNetwork(plan)
    layers = [weights.entry, *weights.residuals]
    dilations = tuple(layer.dilation for layer in weights.residuals)
    channels = len(weights.entry.bias)
    if (dilations, channels, weights.delays) != (plan.dilations, plan.channels, plan.delays):
        raise TrainingError("the weights to start from are of another shape than the plan's")
    rng = np.random.default_rng([plan.seed, plan.n_steps])
    sample = replace(plan, batch=_NORM_WINDOWS)
    hidden = torch.from_numpy(_windows(arrays, sample, rng)[0])
    with torch.no_grad():
        network.entry.weight.copy_(_torch_kernel(layers[0].kernel))
        network.entry.bias.copy_(torch.from_numpy(layers[0].bias))
        hidden = torch.relu(network.entry(nn.functional.pad(hidden, (2, 0))))
        for block, layer in zip(network.body, layers[1:], strict=True):
            assert isinstance(block, _Residual)
            block.conv.weight.copy_(_torch_kernel(layer.kernel))
            given = block.conv(nn.functional.pad(hidden, (block.padding, 0)))
            mean, variance = given.mean(dim=(0, 2)), given.var(dim=(0, 2))
            block.norm.running_mean.copy_(mean)
            block.norm.running_var.copy_(variance)
            block.norm.weight.copy_(torch.sqrt(variance + block.norm.eps))
            block.norm.bias.copy_(torch.from_numpy(layer.bias) + mean)
            hidden = hidden + torch.relu(given + torch.from_numpy(layer.bias)[:, None])
        network.exit.weight.copy_(torch.from_numpy(weights.output.T[:, :, None]))
        network.exit.bias.copy_(torch.from_numpy(weights.output_bias))
    return network


def _learn(
    network: TorchNetwork,
    optimizer: torch.optim.Optimizer,
    arrays: Sequence[TrainingArray],
    plan: TrainingPlan,
    step: int,
) -> float:
    """One step; its loss."""
    features, targets = _windows(arrays, plan, np.random.default_rng([plan.seed, step]))
    for group in optimizer.param_groups:
        group["lr"] = _rate(plan, step)
    network.train()
    # Half the time of float32 on processors with bfloat16 arithmetic; the weights stay float32.
    with torch.autocast("cpu", torch.bfloat16):
        logits = network(torch.from_numpy(features))
    loss = _loss(logits.float(), torch.from_numpy(targets), plan)
    optimizer.zero_grad()
    loss.backward()
    nn.utils.clip_grad_norm_(network.parameters(), 2.0)
    optimizer.step()
    value: float = loss.item()
    return value


def _windows(
    arrays: Sequence[TrainingArray], plan: TrainingPlan, rng: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Features (batch, 40, window), some bands blanked; targets (batch, n_heads, window)."""
    features = np.empty((plan.batch, N_BANDS, plan.window), np.float32)
    targets = np.empty((plan.batch, len(plan.delays), plan.window), np.int64)
    for index in range(plan.batch):
        heavy = len(arrays) > 1 and rng.random() > _LIGHT_SHARE
        array = arrays[int(rng.integers(1, len(arrays)))] if heavy else arrays[0]
        first = int(rng.integers(0, max(1, len(array.features) - plan.window)))
        part = slice(first, first + plan.window)
        features[index] = array.features[part].T
        targets[index] = array.targets[part].T
        if rng.random() < 0.5:
            band = int(rng.integers(0, N_BANDS - _MASKED_BANDS))
            features[index, band : band + int(rng.integers(1, _MASKED_BANDS))] = 0.0
    return features, targets


def _rate(plan: TrainingPlan, step: int) -> float:
    """Learning rate: up for the first 4 %, then half a cosine down to nothing."""
    warm = max(1, round(0.04 * plan.n_steps))
    if step < warm:
        return plan.peak_rate * (step + 1) / warm
    share = (step - warm) / (plan.n_steps - warm)
    return plan.peak_rate * 0.5 * (1.0 + math.cos(math.pi * share))


def _loss(logits: torch.Tensor, targets: torch.Tensor, plan: TrainingPlan) -> torch.Tensor:
    """Cross entropy of phones plus half that of viseme classes, weighted over the heads."""
    log_p = torch.log_softmax(logits, dim=2)
    members = _viseme_members()
    total = torch.zeros(())
    for head, weight in enumerate(plan.head_weights):
        phones, viseme_targets = log_p[:, head], _viseme_targets(targets[:, head])
        visemes = torch.log(torch.einsum("bpn,pv->bvn", phones.exp(), members) + 1e-8)
        total = total + weight * (
            nn.functional.nll_loss(phones, targets[:, head], ignore_index=NO_TARGET)
            + 0.5 * nn.functional.nll_loss(visemes, viseme_targets, ignore_index=NO_TARGET)
        )
    return total


def _viseme_members() -> torch.Tensor:
    """(40, n_visemes): 1 where the phone is of the class."""
    members = torch.zeros(len(PHONEMES), _N_VISEMES)
    for index, phoneme in enumerate(PHONEMES):
        members[index, VISEME_OF[phoneme]] = 1.0
    return members


def _viseme_targets(targets: torch.Tensor) -> torch.Tensor:
    classes = torch.tensor([VISEME_OF[phoneme] for phoneme in PHONEMES])
    return torch.where(targets == NO_TARGET, NO_TARGET, classes[targets.clamp(min=0)])


def _resume(
    path: Path, network: nn.Module, average: nn.Module, optimizer: torch.optim.Optimizer
) -> int:
    """Load the state where there is one; the step to go on with."""
    if not path.exists():
        return 0
    state = torch.load(path, weights_only=True)
    network.load_state_dict(state["network"])
    average.load_state_dict(state["average"])
    optimizer.load_state_dict(state["optimizer"])
    return int(state["step"])


def _save(
    path: Path,
    step: int,
    network: nn.Module,
    average: nn.Module,
    optimizer: torch.optim.Optimizer,
) -> None:
    state = {
        "step": step,
        "network": network.state_dict(),
        "average": average.state_dict(),
        "optimizer": optimizer.state_dict(),
    }
    with written_whole(path) as partial:
        torch.save(state, partial)


def _kernel(weight: torch.Tensor) -> NDArray[np.float32]:
    """(out, in, 3 taps) as (3 taps x in, out): a frame's past and present times one matrix."""
    return _numpy(weight.permute(2, 1, 0).flatten(0, 1))


def _torch_kernel(kernel: NDArray[np.float32]) -> torch.Tensor:
    """The other way round."""
    taps = torch.from_numpy(kernel).unflatten(0, (3, -1))
    return taps.permute(2, 1, 0)


def _numpy(tensor: torch.Tensor) -> NDArray[np.float32]:
    return np.ascontiguousarray(tensor.detach().numpy(), dtype=np.float32)
