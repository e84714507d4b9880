"""Train the network's weights with torch (extra `train`); nothing here is needed at run time.

Random windows of the training arrays, cross entropy of phones and of viseme classes for every head,
AdamW under a cosine schedule, a running average of the weights. Every step draws its windows from
(seed, step), so that an interrupted run goes on exactly as it would have.
"""

import hashlib
import io
import json
import math
import os
import pickle
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from lipservo_lab.baselines.visible_error import visible_distances_mm
from lipservo_lab.learning.recognition.torch_network import TorchNetwork, exported, started_from
from lipservo_lab.learning.recognition.training_data import (
    NO_TARGET,
    Taught,
    TrainingArray,
    TrainingError,
    TrainingPlan,
    draw_windows,
)
from lipsync.errors import UserError
from lipsync.output_file import write_whole
from lipsync.phonemes import PHONEMES, VISEME_CLASSES, VISEME_OF
from lipsync.recognition.features import FeatureScale
from lipsync.recognition.network import NetworkWeights, load_weights, save_weights

_N_VISEMES = len(VISEME_CLASSES)
#: Files of a run's folder.
STATE = "state.pt"
_LOG, _BEST = "log.jsonl", "best.npz"
_NUMBER_BYTES = 4
#: Processes that draw windows for a GPU.
_DRAWERS = 4
#: Sums of a frame's posteriors below this mean that the frame has none; posteriors are stored as
#: float16 and add up to nearly 1.
_NO_POSTERIORS = 0.5
#: Name of the figure of a check by which the best weights are chosen.
SCORE = "score"

Checkpoint = Callable[[int, NetworkWeights], Mapping[str, float]]


class TrainingStoppedError(UserError):
    """Training was stopped before its end and can go on later; the message is one line."""


@dataclass(slots=True)
class _Learner:
    """All that changes from step to step; the file of the state contains it.

    average: running average of the network's weights. step: steps done. best: the highest score so
    far. losses: of the steps since the last line of the log.
    """

    network: TorchNetwork
    average: torch.optim.swa_utils.AveragedModel
    optimizer: torch.optim.Optimizer
    step: int = 0
    best: float = -math.inf
    losses: list[float] = field(default_factory=list)

    def save(self, path: Path, about: str) -> None:
        """Write the state, completely or not at all.

        about: what the run learns from, as `_about` returns it. Raises OutputError, for example on
        a full disk.
        """
        state = {
            "about": about,
            "step": self.step,
            "best": self.best,
            "losses": self.losses,
            "network": self.network.state_dict(),
            "average": self.average.state_dict(),
            "optimizer": self.optimizer.state_dict(),
        }
        write_whole(path, _packed(state))

    def load(self, path: Path, about: str) -> None:
        """Take over a saved state.

        about: what this run learns from. Raises TrainingError for a damaged file, for one that is
        not a state, and for the state of a run that learns from something else.
        """
        try:
            state = _unpacked(path.read_bytes())
            saved = json.loads(state["about"])
        except (OSError, RuntimeError, ValueError, LookupError, TypeError, EOFError) as error:
            raise TrainingError(f"{path}: damaged or no state; delete it to begin anew") from error
        except pickle.UnpicklingError as error:
            raise TrainingError(f"{path}: no state of a training; choose another folder") from error
        for key, value in json.loads(about).items():
            if saved.get(key) != value:
                raise TrainingError(
                    f"{path}: is of another run: {key} was {saved.get(key)}, now {value}; give "
                    "what it was begun with, or choose another folder"
                )
        self.network.load_state_dict(state["network"])
        self.average.load_state_dict(state["average"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.step, self.best, self.losses = state["step"], state["best"], state["losses"]


def _packed(state: Mapping[str, object]) -> bytes:
    """Return a state as compressed bytes.

    The first bytes of all 4-byte numbers are stored together, then the second ones, and so on: of
    neighbouring numbers the exponents are nearly the same, which makes the file a quarter smaller.
    """
    buffer = io.BytesIO()
    torch.save(state, buffer)
    content = buffer.getvalue() + bytes(-buffer.tell() % _NUMBER_BYTES)
    planes = np.frombuffer(content, np.uint8).reshape(-1, _NUMBER_BYTES).T
    return zlib.compress(planes.tobytes(), level=1)


def _unpacked(packed: bytes) -> dict[str, Any]:
    """Return the state in `_packed` bytes; raises ValueError for other or truncated bytes."""
    try:
        planes = np.frombuffer(zlib.decompress(packed), np.uint8).reshape(_NUMBER_BYTES, -1)
    except zlib.error as error:
        raise ValueError(str(error)) from error
    content = io.BytesIO(planes.T.tobytes())
    state: dict[str, Any] = torch.load(content, map_location="cpu", weights_only=True)
    return state


def train_network(
    arrays: Sequence[TrainingArray],
    scale: FeatureScale,
    plan: TrainingPlan,
    *,
    folder: Path,
    start: NetworkWeights | None = None,
    taught: Taught | None = None,
    check: Checkpoint = lambda _step, _weights: {},
    after_step: Callable[[int], bool | None] = lambda _step: False,
) -> NetworkWeights:
    """Train the network on arrays, the first of which is the lightly changed copy.

    Parameters
    ----------
    arrays : Sequence[TrainingArray]
        Features of shape (n_frames, 40), and targets.
    scale : FeatureScale
        Of the features; stored in the weights.
    plan : TrainingPlan
        Shape, schedule and seed.
    folder : Path
        Keeps the state (`state.pt`) and the log (`log.jsonl`): a run that finds a state there goes
        on from it, to the same bits on one thread.
    start : NetworkWeights | None
        Weights to begin with in place of random ones; a smaller network grows.
    taught : Taught | None
        A teacher's labels and posteriors, for targets of len(PHONEMES) or more.
    check : Checkpoint
        Called now and then with the steps done and the averaged weights; its figures go into the
        log. If `score` is among them, the weights with the highest one are kept as `best.npz`.
    after_step : Callable[[int], bool | None]
        Called with the steps done; if it returns true, the state is saved and TrainingStoppedError
        raised.

    Returns
    -------
    NetworkWeights
        The best weights if `check` returned scores, else the running average at the end.

    Raises
    ------
    TrainingError
        `start` or the state does not fit.
    OutputError
        The state cannot be written.
    TrainingStoppedError
        `after_step` returned true before the last step.
    """
    torch.manual_seed(plan.seed)
    torch.set_num_threads(plan.n_threads)
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    network = TorchNetwork(plan) if start is None else started_from(start, arrays, plan)
    network.to(device)
    average = torch.optim.swa_utils.AveragedModel(
        network,
        multi_avg_fn=torch.optim.swa_utils.get_ema_multi_avg_fn(plan.averaging),
        use_buffers=True,
    )
    optimizer = torch.optim.AdamW(network.parameters(), weight_decay=plan.weight_decay)
    learner = _Learner(network, average, optimizer)
    state, about = folder / STATE, _about(arrays, plan, start, taught)
    if state.exists():
        learner.load(state, about)
    _shorten_log(folder / _LOG, learner.step)
    with (folder / _LOG).open("a", encoding="utf-8") as log:
        for batch in _batches(arrays, taught, plan, learner.step, device):
            rate = learning_rate(plan, learner.step)
            learner.losses.append(learn_from(batch, network, optimizer, plan, rate))
            average.update_parameters(network)
            learner.step += 1
            is_stopped = after_step(learner.step)
            is_last = learner.step == plan.n_steps
            if learner.step % plan.log_every == 0 or is_last:
                record = {"step": learner.step, "loss": float(np.mean(learner.losses))}
                learner.losses.clear()
                if learner.step % plan.check_every == 0 or is_last:
                    weights = exported(average.module, scale, plan)
                    record |= check(learner.step, weights)
                    if record.get(SCORE, -math.inf) > learner.best:
                        learner.best = record[SCORE]
                        save_weights(weights, folder / _BEST)
                log.write(json.dumps(record) + "\n")
                log.flush()
                if learner.step % plan.check_every == 0 or is_last:
                    learner.save(state, about)
            if is_stopped and not is_last:
                learner.save(state, about)
                raise TrainingStoppedError(
                    f"{folder}: stopped after step {learner.step} of {plan.n_steps}; the same "
                    "command with --resume goes on"
                )
    if learner.best > -math.inf:
        return load_weights(folder / _BEST)
    return exported(average.module, scale, plan)


def _about(
    arrays: Sequence[TrainingArray],
    plan: TrainingPlan,
    start: NetworkWeights | None,
    taught: Taught | None,
) -> str:
    """Return what a run learns from, as JSON; a state only serves a run with the same.

    It holds the plan, but for `_NOT_LEARNT`, and digests of arrays, starting weights and teacher.
    """
    learnt_arrays = [part for each in arrays for part in (each.features, each.targets)]
    plan_fields = {key: value for key, value in asdict(plan).items() if key not in _NOT_LEARNT}
    about = {
        **plan_fields,
        "corpus": _digest(learnt_arrays),
        "start": _digest([] if start is None else [start.output]),
        "teacher": _digest([] if taught is None else [taught.posteriors]),
    }
    return json.dumps(about)


def _digest(arrays: Sequence[NDArray[np.generic]]) -> str:
    """Return a digest of every 17th row of the arrays."""
    digest = hashlib.blake2b(digest_size=8)
    for array in arrays:
        digest.update(array[::_DIGEST_STEP].tobytes())
    return digest.hexdigest()


#: Only every so manyth row is digested: a corpus that differs does so in many rows.
_DIGEST_STEP = 17
#: Fields of the plan that change no weights but by rounding.
_NOT_LEARNT = ("n_threads", "log_every", "check_every")


def _shorten_log(path: Path, step: int) -> None:
    """Remove lines of the log that an interrupted run wrote after its last saved state.

    step: steps done in that state.
    """
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True) if path.exists() else []
    kept = []
    for line in lines:
        try:
            is_kept = line.endswith("\n") and json.loads(line)["step"] <= step
        except (ValueError, LookupError, TypeError):
            is_kept = False  # torn by the interruption
        kept += [line] if is_kept else []
    if kept != lines:
        write_whole(path, "".join(kept))


@dataclass(frozen=True, slots=True)
class Batch:
    """Windows of one step on the device: features (b, 40, n), labels (b, n_heads, n).

    soft: a teacher's posteriors (b, n_heads, n, n_phonemes), 0 for frames without; None without a
    teacher.
    """

    features: torch.Tensor
    labels: torch.Tensor
    soft: torch.Tensor | None


class _Windows:
    """The windows of each step, drawn from (seed, step); a dataset for torch's DataLoader."""

    def __init__(self, arrays: Sequence[TrainingArray], plan: TrainingPlan) -> None:
        self._arrays = arrays
        self._plan = plan

    def __getitem__(self, step: int) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
        """Return features (b, 40, n) and targets (b, n_heads, n) of a step."""
        rng = np.random.default_rng([self._plan.seed, step])
        return draw_windows(self._arrays, self._plan, rng)


def _batches(
    arrays: Sequence[TrainingArray],
    taught: Taught | None,
    plan: TrainingPlan,
    first: int,
    device: torch.device,
) -> Iterator[Batch]:
    """Yield the batches of all steps from `first` on, on the device.

    For a GPU other processes draw the windows. taught: replaces targets of len(PHONEMES) or more.
    """
    is_gpu = device.type == "cuda"
    loader = torch.utils.data.DataLoader(
        _Windows(arrays, plan),
        batch_size=None,
        sampler=range(first, plan.n_steps),
        num_workers=min(_DRAWERS, os.cpu_count() or 1) if is_gpu else 0,
        pin_memory=is_gpu,
    )
    on_device = None
    if taught is not None:
        parts = (torch.from_numpy(each).to(device) for each in (taught.labels, taught.posteriors))
        on_device = TaughtOnDevice(*parts)
    for features, targets in loader:
        moved = features.to(device, non_blocking=True), targets.to(device, non_blocking=True)
        yield Batch(*moved, None) if on_device is None else on_device.batch(*moved)


@dataclass(frozen=True, slots=True)
class TaughtOnDevice:
    """A `Taught` as tensors on one device.

    labels: (n,), posteriors: (n, n_phonemes), of all frames of all recordings; posteriors None:
    only labels are learned.
    """

    labels: torch.Tensor
    posteriors: torch.Tensor | None

    def batch(self, features: torch.Tensor, targets: torch.Tensor) -> Batch:
        """Return a batch with labels and posteriors in place of frame numbers.

        Parameters
        ----------
        features : torch.Tensor
            (b, 40, n).
        targets : torch.Tensor
            (b, n_heads, n): labels below len(PHONEMES); from there on, len(PHONEMES) plus a row of
            `labels`.

        Returns
        -------
        Batch
            On the same device; targets that are labels already get posteriors 0.
        """
        is_known, rows = targets >= len(PHONEMES), (targets - len(PHONEMES)).clamp(min=0)
        labels = torch.where(is_known, self.labels[rows], targets)
        if self.posteriors is None:
            return Batch(features, labels, None)
        soft = self.posteriors[rows].float() * is_known.unsqueeze(-1)
        return Batch(features, labels, soft)


def learn_from(
    batch: Batch,
    network: TorchNetwork,
    optimizer: torch.optim.Optimizer,
    plan: TrainingPlan,
    rate: float,
) -> float:
    """Take one step of the optimizer; return the loss before it.

    Parameters
    ----------
    batch : Batch
        Windows on the network's device.
    network : TorchNetwork
        Changed by the step.
    optimizer : torch.optim.Optimizer
        Its state is changed by the step.
    plan : TrainingPlan
        Weights of the parts of the loss.
    rate : float
        Learning rate.

    Returns
    -------
    float
        The loss.
    """
    for group in optimizer.param_groups:
        group["lr"] = rate
    network.train()
    device = batch.features.device.type
    with torch.autocast(device, torch.bfloat16, enabled=device == "cuda" or _has_bfloat16()):
        logits = network(batch.features).float()
    loss = training_loss(logits, batch.labels, plan)
    if batch.soft is not None:
        loss = loss + plan.soft_share * _soft_loss(logits, batch.labels, batch.soft, plan)
    optimizer.zero_grad()
    loss.backward()
    nn.utils.clip_grad_norm_(network.parameters(), 2.0)
    optimizer.step()
    # Round the running means of gradients to bfloat16, in which gradients are computed: this makes
    # the saved state 2 MB smaller.
    for parameter_state in optimizer.state.values():
        parameter_state["exp_avg"] = parameter_state["exp_avg"].bfloat16().float()
    value: float = loss.item()
    return value


def _soft_loss(
    logits: torch.Tensor, labels: torch.Tensor, soft: torch.Tensor, plan: TrainingPlan
) -> torch.Tensor:
    """Return cross entropy with the teacher's posteriors minus that with the labels.

    Added to the loss with factor `soft_share`, it moves that share of the phones' loss from labels
    to posteriors (Hinton, Vinyals and Dean, 2015). logits: (b, n_heads, n_phonemes, n); labels: (b,
    n_heads, n); soft: (b, n_heads, n, n_phonemes). Frames without posteriors (sum 0) count nothing;
    each head is averaged over its other frames, then weighted.
    """
    log_p = torch.log_softmax(logits, dim=2).permute(0, 1, 3, 2)
    is_known = soft.sum(dim=3) > _NO_POSTERIORS
    n_known = is_known.sum(dim=(0, 2)).clamp(min=1)
    label_losses = -log_p.gather(3, labels.clamp(min=0).unsqueeze(3)).squeeze(3) * is_known
    head_losses = (-(soft * log_p).sum(dim=3) - label_losses).sum(dim=(0, 2)) / n_known
    return (head_losses * head_losses.new_tensor(plan.head_weights)).sum()


def _has_bfloat16() -> bool:
    """Return whether the processor has instructions for bfloat16.

    With them it takes half the time of float32, without them twice as much. The weights stay
    float32.
    """
    able: dict[str, bool] = getattr(torch.cpu, "get_capabilities", dict)()  # not in older ones
    return bool(able.get("avx512_bf16") or able.get("amx_bf16"))


def learning_rate(plan: TrainingPlan, step: int) -> float:
    """Return the learning rate of a step: up for the first 4 %, then half a cosine down to 0."""
    warm = max(1, round(0.04 * plan.n_steps))
    if step < warm:
        return plan.peak_rate * (step + 1) / warm
    share = (step - warm) / (plan.n_steps - warm)
    return plan.peak_rate * 0.5 * (1.0 + math.cos(math.pi * share))


def training_loss(logits: torch.Tensor, targets: torch.Tensor, plan: TrainingPlan) -> torch.Tensor:
    """Return the cross entropy of phones plus half that of viseme classes, weighted over the heads.

    logits: (b, n_heads, n_phonemes, n); targets: (b, n_heads, n), NO_TARGET where a frame has none.
    With `visible_weight` the expected visible distance between the true viseme class and the
    posteriors is added, per mm.
    """
    log_p = torch.log_softmax(logits, dim=2)
    members = _viseme_members().to(logits.device)
    weights = _viseme_weights(plan).to(logits.device)
    total = logits.new_zeros(())
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
        if plan.visible_weight:
            known = viseme_targets != NO_TARGET
            apart_mm = _viseme_distances_mm().to(logits.device)
            expected_mm = apart_mm[viseme_targets[known]] * visemes.permute(0, 2, 1)[known].exp()
            total = total + weight * plan.visible_weight * expected_mm.sum(dim=1).mean()
    return total


def _viseme_distances_mm() -> torch.Tensor:
    """Return how far the faces of two viseme classes are apart, (n_visemes, n_visemes) mm."""
    return torch.tensor(visible_distances_mm(), dtype=torch.float32)


def _viseme_members() -> torch.Tensor:
    """Return 1 where a phoneme belongs to a viseme class, else 0, (n_phonemes, n_visemes)."""
    members = torch.zeros(len(PHONEMES), _N_VISEMES)
    for index, phoneme in enumerate(PHONEMES):
        members[index, VISEME_OF[phoneme]] = 1.0
    return members


def _viseme_weights(plan: TrainingPlan) -> torch.Tensor:
    """Return the weights of viseme classes in the loss, (n_visemes,): larger for closures."""
    weights = torch.ones(_N_VISEMES)
    for phoneme in ("P", "F"):
        weights[VISEME_OF[phoneme]] = plan.closure_weight
    return weights


def _viseme_targets(targets: torch.Tensor) -> torch.Tensor:
    """Return the viseme class of each phoneme target; NO_TARGET stays."""
    classes = torch.tensor([VISEME_OF[phoneme] for phoneme in PHONEMES], device=targets.device)
    return torch.where(targets == NO_TARGET, NO_TARGET, classes[targets.clamp(min=0)])
