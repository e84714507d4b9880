"""Adapt the weights of the recogniser to minutes of one voice; they stay near what they were.

The whole network learns at a low rate for a hundred steps, from copies of the recordings disturbed
as in training. Two things keep what it knows of other voices. After each step every weight is drawn
back towards where it began, in proportion to its distance from there: L2-SP of Li, Grandvalet and
Davoine (Explicit inductive bias for transfer learning, ICML 2018), equation 3, here decoupled from
Adam's scaling as weight decay is in AdamW. And the statistics of the batch norms stay as they were:
a single voice says nothing about what the layers give for all voices.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import nn

from lipservo_lab.learning.recognition.augmentation import LabelledSamples
from lipservo_lab.learning.recognition.network_training import learning_rate, training_loss
from lipservo_lab.learning.recognition.torch_network import exported, started_from
from lipservo_lab.learning.recognition.training_data import (
    TrainingArray,
    TrainingPlan,
    draw_windows,
    training_arrays,
)
from lipsync.recognition.network import NetworkWeights


@dataclass(frozen=True, slots=True)
class AdaptationPlan:
    """How to learn a voice; chosen by measurement (docs/decisions/training-of-the-ears.md).

    batch: windows a step; window: frames of 10 ms in each. n_copies: of the recordings, heavily
    disturbed by noise, rooms and lines. pull: after each step at a learning rate r, every weight
    goes back by the share r * pull of its distance from where it began.
    """

    n_steps: int = 100
    batch: int = 8
    window: int = 400
    peak_rate: float = 5e-4
    pull: float = 10.0
    n_copies: int = 2
    seed: int = 0
    n_threads: int = 2

    def for_network(self, weights: NetworkWeights) -> TrainingPlan:
        """Return the plan of a training for a network with the shape of `weights`.

        A network with another number of heads than usual has equal weights of the heads.
        """
        default = TrainingPlan()
        n_heads = len(weights.delays)
        is_default = n_heads == len(default.head_weights)
        return TrainingPlan(
            head_weights=default.head_weights if is_default else (1.0 / n_heads,) * n_heads,
            n_steps=self.n_steps,
            batch=self.batch,
            window=self.window,
            peak_rate=self.peak_rate,
            seed=self.seed,
            n_threads=self.n_threads,
        ).shaped_as(weights)


def adapt(
    start: NetworkWeights,
    recordings: Sequence[LabelledSamples],
    plan: AdaptationPlan,
    advance: Callable[[str, int, int], None] = lambda _what, _done, _all: None,
) -> NetworkWeights:
    """Return weights adapted to the voice of the recordings.

    advance: called with the work ("disturbing", then "learning"), steps done and all steps. With
    one thread the same seed gives the same weights on one kind of processor.
    """
    n_arrays = 1 + plan.n_copies
    arrays = []
    for array in training_arrays(
        recordings,
        start.scale,
        start.delays,
        n_heavy=plan.n_copies,
        seed=plan.seed,
        n_processes=min(plan.n_threads, n_arrays),
    ):
        arrays.append(array)
        advance("disturbing", len(arrays), n_arrays)
    return learn_voice(start, arrays, plan, lambda n: advance("learning", n, plan.n_steps))


def learn_voice(
    start: NetworkWeights,
    arrays: Sequence[TrainingArray],
    plan: AdaptationPlan,
    progress: Callable[[int], None] = lambda _step: None,
) -> NetworkWeights:
    """Adapt weights to training arrays of one voice.

    Parameters
    ----------
    start : NetworkWeights
        The weights to adapt; they are not changed.
    arrays : Sequence[TrainingArray]
        Features of shape (n_frames, 40) and targets; the first array is the lightly changed copy.
    plan : AdaptationPlan
        Steps, rates and seed.
    progress : Callable[[int], None]
        Called after each step with the number of steps done.

    Returns
    -------
    NetworkWeights
        The running average of the adapted weights.
    """
    schedule = plan.for_network(start)
    torch.manual_seed(plan.seed)
    torch.set_num_threads(plan.n_threads)
    network = started_from(start, arrays, schedule)
    # Batch norms keep their running means and variances.
    network.eval()
    average = torch.optim.swa_utils.AveragedModel(
        network, multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(schedule.averaging)
    )
    starts = [parameter.detach().clone() for parameter in network.parameters()]
    optimizer = torch.optim.Adam(network.parameters())
    for step in range(plan.n_steps):
        rate = learning_rate(schedule, step)
        rng = np.random.default_rng([plan.seed, step])
        features, targets = draw_windows(arrays, schedule, rng)
        loss = training_loss(
            network(torch.from_numpy(features)), torch.from_numpy(targets), schedule
        )
        for group in optimizer.param_groups:
            group["lr"] = rate
        optimizer.zero_grad()
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 2.0)
        optimizer.step()
        with torch.no_grad():
            for parameter, started in zip(network.parameters(), starts, strict=True):
                # L2-SP: back towards the starting value.
                parameter.lerp_(started, min(1.0, rate * plan.pull))
        average.update_parameters(network)
        progress(step + 1)
    return exported(average.module, start.scale, schedule)
