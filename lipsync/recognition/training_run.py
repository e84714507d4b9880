"""One training from corpora to weights: align, split by speaker, disturb, learn, write a log."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from lipsync.corpus.transcribed import TranscribedUtterance, read_transcribed
from lipsync.errors import UserError
from lipsync.phonemes import PHONEMES, SILENCE, VISEME_CLASSES, VISEME_OF
from lipsync.recognition import noise
from lipsync.recognition.alignment_cache import AlignedUtterance, align_corpus
from lipsync.recognition.augmentation import Heard
from lipsync.recognition.features import FeatureScale
from lipsync.recognition.network import NetworkWeights, batch_posteriors
from lipsync.recognition.training import TrainingPlan, train_network
from lipsync.recognition.training_data import (
    TrainingArray,
    as_array,
    feature_scale,
    read_heard,
    training_arrays,
)

#: The scale needs no more than every sixth utterance.
_SCALE_STEP = 6
#: So many validation utterances are enough for a curve.
_MOST_VALIDATION = 40
_CLASS_OF = np.array([VISEME_OF[phoneme] for phoneme in PHONEMES])
_MEMBERSHIP = np.eye(len(VISEME_CLASSES), dtype=np.float32)[_CLASS_OF]

#: What is done, how many, of how many.
Advance = Callable[[str, int, int], None]


class TrainingError(UserError):
    """Nothing to learn from; the message is one line."""


@dataclass(frozen=True, slots=True)
class TrainingRun:
    """What to learn from, and where the run is kept."""

    corpora: tuple[Path, ...]
    folder: Path
    held_out: frozenset[str]
    validation: frozenset[str]
    seed: int
    n_steps: int
    n_copies: int
    n_processes: int
    plan: TrainingPlan = field(default_factory=TrainingPlan)


def run_training(run: TrainingRun, advance: Advance) -> NetworkWeights:
    """Learn; a run that was interrupted goes on from what its folder holds.

    Speakers held out are not even aligned. Raises TrainingError where no speaker is left.
    """
    run.folder.mkdir(parents=True, exist_ok=True)
    plan = replace(run.plan, seed=run.seed, n_steps=run.n_steps)
    utterances, alignments = _aligned(run, advance)
    usable = [u for u in utterances if not alignments[u.name].error]
    training = [u for u in usable if u.speaker not in run.validation]
    if not training:
        raise TrainingError("no utterance is left to learn from; hold out fewer speakers")
    clean = [read_heard(u, alignments[u.name]) for u in training]
    scale = feature_scale(clean[::_SCALE_STEP])
    arrays = training_arrays(
        clean,
        scale,
        plan.delays,
        n_heavy=run.n_copies,
        seed=run.seed,
        n_processes=min(run.n_processes, 1 + run.n_copies),
        progress=lambda n: advance("disturbing", n, 1 + run.n_copies),
    )
    validation = [u for u in usable if u.speaker in run.validation]
    step = max(1, len(validation) // _MOST_VALIDATION)
    heard = [read_heard(u, alignments[u.name]) for u in validation[::step]]
    conditions = _conditions(heard, scale, plan.delays)
    return train_network(
        arrays,
        scale,
        plan,
        folder=run.folder,
        check=lambda _step, weights: figures(weights, conditions),
        progress=lambda n: advance("learning", n, plan.n_steps),
    )


def figures(weights: NetworkWeights, conditions: Mapping[str, TrainingArray]) -> dict[str, float]:
    """Frame accuracies without a decoder: phones and viseme classes, condition by condition."""
    found: dict[str, float] = {}
    silence = PHONEMES.index(SILENCE)
    for name, array in conditions.items():
        posteriors = batch_posteriors(weights, array.features.astype(np.float32))
        for head, delay in enumerate(weights.delays):
            known = array.targets[:, head] >= 0
            targets = array.targets[known, head]
            phones = posteriors[known, head]
            visemes_right = (phones @ _MEMBERSHIP).argmax(axis=1) == _CLASS_OF[targets]
            key = f"{name}_delay{delay}"
            found[f"{key}_phone_all"] = float(np.mean(phones.argmax(axis=1) == targets))
            found[f"{key}_viseme_all"] = float(np.mean(visemes_right))
            found[f"{key}_viseme_speech"] = float(np.mean(visemes_right[targets != silence]))
    return found


def _aligned(
    run: TrainingRun, advance: Advance
) -> tuple[list[TranscribedUtterance], dict[str, AlignedUtterance]]:
    utterances = [
        utterance
        for corpus in run.corpora
        for utterance in read_transcribed(corpus)
        if utterance.speaker not in run.held_out
    ]
    done: list[str] = []

    def count(name: str) -> None:
        done.append(name)
        advance("aligning", len(done), len(utterances))

    alignments = align_corpus(
        tuple(utterances),
        run.folder / "alignments.jsonl",
        n_processes=run.n_processes,
        progress=count,
    )
    return utterances, alignments


def _conditions(
    heard: Sequence[Heard], scale: FeatureScale, delays: Sequence[int]
) -> dict[str, TrainingArray]:
    """The validation utterances clean, in white noise at 10 dB, and 30 dB lower; none: nothing."""
    if not heard:
        return {}
    rng = np.random.default_rng(0)
    noisy = [
        replace(h, samples=noise.add_noise(h.samples, noise.white(rng, len(h.samples)), 10.0))
        for h in heard
    ]
    quiet = [replace(h, samples=h.samples * np.float32(10.0**-1.5)) for h in heard]
    ways = {"clean": heard, "white_10db": noisy, "level_-30db": quiet}
    return {name: as_array(way, scale, delays) for name, way in ways.items()}
