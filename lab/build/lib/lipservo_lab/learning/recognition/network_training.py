"""Learning the network's weights with torch (extra `train`); nothing here is needed to run.

Random windows of the training arrays, cross entropy of phones and of viseme classes for every
head, AdamW under a cosine schedule, a running average of the weights. Every step draws its windows
from (seed, step), so that a run that was interrupted goes on exactly as it would have.
"""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import nn

from lipservo_lab.learning.recognition.torch_network import TorchNetwork, exported, started_from
from lipservo_lab.learning.recognition.training_data import (
    NO_TARGET,
    TrainingArray,
    TrainingPlan,
    draw_windows,
)
from lipsync.output_file import written_whole
from lipsync.phonemes import PHONEMES, VISEME_CLASSES, VISEME_OF
from lipsync.recognition.features import FeatureScale
from lipsync.recognition.network import NetworkWeights

_N_VISEMES = len(VISEME_CLASSES)

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


def _learn(
    network: TorchNetwork,
    optimizer: torch.optim.Optimizer,
    arrays: Sequence[TrainingArray],
    plan: TrainingPlan,
    step: int,
) -> float:
    """One step; its loss."""
    features, targets = draw_windows(arrays, plan, np.random.default_rng([plan.seed, step]))
    for group in optimizer.param_groups:
        group["lr"] = learning_rate(plan, step)
    network.train()
    with torch.autocast("cpu", torch.bfloat16, enabled=_has_bfloat16()):
        logits = network(torch.from_numpy(features))
    loss = training_loss(logits.float(), torch.from_numpy(targets), plan)
    optimizer.zero_grad()
    loss.backward()
    nn.utils.clip_grad_norm_(network.parameters(), 2.0)
    optimizer.step()
    value: float = loss.item()
    return value


def _has_bfloat16() -> bool:
    """Whether the processor calculates in bfloat16: half the time of float32, else twice as much.

    The weights stay float32.
    """
    able: dict[str, bool] = getattr(torch.cpu, "get_capabilities", dict)()  # not in older ones
    return bool(able.get("avx512_bf16") or able.get("amx_bf16"))


def learning_rate(plan: TrainingPlan, step: int) -> float:
    """Learning rate: up for the first 4 %, then half a cosine down to nothing."""
    warm = max(1, round(0.04 * plan.n_steps))
    if step < warm:
        return plan.peak_rate * (step + 1) / warm
    share = (step - warm) / (plan.n_steps - warm)
    return plan.peak_rate * 0.5 * (1.0 + math.cos(math.pi * share))


def training_loss(logits: torch.Tensor, targets: torch.Tensor, plan: TrainingPlan) -> torch.Tensor:
    """Cross entropy of phones plus half that of viseme classes, weighted over the heads."""
    log_p = torch.log_softmax(logits, dim=2)
    members, weights = _viseme_members(), _viseme_weights(plan)
    total = torch.zeros(())
    for head, weight in enumerate(plan.head_weights):
        phones, viseme_targets = log_p[:, head], _viseme_targets(targets[:, head])
        visemes = torch.log(torch.einsum("bpn,pv->bvn", phones.exp(), members) + 1e-8)
        total = total + weight * (
            nn.functional.nll_loss(phones, targets[:, head], ignore_index=NO_TARGET)
            + 0.5
            * nn.functional.nll_loss(
                visemes, viseme_targets, weight=weights, ignore_index=NO_TARGET
            )
        )
    return total


def _viseme_members() -> torch.Tensor:
    """(40, n_visemes): 1 where the phone is of the class."""
    members = torch.zeros(len(PHONEMES), _N_VISEMES)
    for index, phoneme in enumerate(PHONEMES):
        members[index, VISEME_OF[phoneme]] = 1.0
    return members


def _viseme_weights(plan: TrainingPlan) -> torch.Tensor:
    """(n_visemes,): closures count more."""
    weights = torch.ones(_N_VISEMES)
    for phoneme in ("P", "F"):
        weights[VISEME_OF[phoneme]] = plan.closure_weight
    return weights


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
