"""How the network is trained: its shape, the schedule, and the windows that a step learns from."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lipservo_lab.learning.recognition.training_data import TrainingArray
from lipsync.errors import UserError
from lipsync.recognition.features import N_BANDS
from lipsync.recognition.network import NetworkWeights

#: Chance that a window of the lightly changed copy is drawn; the heavily changed share the rest.
_LIGHT_SHARE = 0.25
_MASKED_BANDS = 8


class TrainingError(UserError):
    """There is nothing to learn from, or the parts do not fit; the message is one line."""


@dataclass(frozen=True, slots=True)
class TrainingPlan:
    """How to learn; the defaults are those of `lipservo learn recognizer`.

    closure_weight: of a frame of P B M or F V in the loss of the viseme classes. A closure that is
    missed is seen by everybody, one too many by few, so missing one costs more.
    """

    delays: tuple[int, ...] = (2, 7, 12)
    head_weights: tuple[float, ...] = (0.3, 0.5, 0.2)
    dilations: tuple[int, ...] = (1, 2, 4, 8, 1, 2, 4, 8)
    channels: int = 192
    n_steps: int = 5_000
    batch: int = 32
    window: int = 400
    peak_rate: float = 3e-3
    weight_decay: float = 0.02
    closure_weight: float = 2.0
    seed: int = 0
    n_threads: int = 2
    log_every: int = 50
    check_every: int = 100

    @property
    def averaging(self) -> float:
        """Share of the running average that stays at each step: it spans a quarter of the run."""
        return 1.0 - 4.0 / max(8, self.n_steps)

    def shaped_as(self, weights: NetworkWeights) -> "TrainingPlan":
        """The same schedule for a network of this shape."""
        return replace(
            self,
            delays=weights.delays,
            dilations=tuple(layer.dilation for layer in weights.residuals),
            channels=len(weights.entry.bias),
        )


def draw_windows(
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
