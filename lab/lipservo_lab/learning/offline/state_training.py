"""A corpus becomes a state model."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from lipservo_lab.corpus.utterance import Utterance
from lipservo_lab.learning.offline.manifold import N_LANDMARKS, speech_manifold
from lipservo_lab.learning.offline.parameters import find_components, joint_parameters, velocities
from lipservo_lab.learning.offline.states import bisected_states, state_gaussians, transitions
from lipsync.arrays import Array
from lipsync.errors import UserError
from lipsync.offline.state_model import StateModel, Units
from lipsync.offline.stored_units import frames_between, joined_phones, unit_spans
from lipsync.phonemes import PHONEMES

Progress = Callable[[str], None]


class BuildingError(UserError):
    """A corpus that no state model can be made of; one line."""


@dataclass(frozen=True, slots=True)
class Recipe:
    """What the paper leaves open, chosen on inner splits (docs/decisions/0029)."""

    n_components: int = 10
    n_states: int = 100
    n_landmarks: int = N_LANDMARKS
    shrinkage: float = 20.0
    seed: int = 0


def build_states(
    utterances: Sequence[Utterance],
    cepstra: Sequence[Array],
    recipe: Recipe | None = None,
    progress: Progress = lambda _: None,
) -> StateModel:
    """A state model of labelled sentences, and of what is heard at each of their frames.

    cepstra: (n_frames, m) of each. Raises BuildingError for too few frames, and for sentences at
    different rates.
    """
    recipe = recipe or Recipe()
    rates = {u.frame_rate_hz for u in utterances}
    if len(rates) != 1:
        raise BuildingError(f"sentences at {len(rates)} frame rates; a state model has one")
    frame_rate_hz = rates.pop()
    frames = [_flat(u) for u in utterances]
    borders = np.concatenate([[0], np.cumsum([len(each) for each in frames])])
    _check_numbers(recipe, int(borders[-1]), frames[0].shape[1])
    with threadpool_limits(limits=1):  # several threads add up in changing order
        progress("principal components")
        components = find_components(frames, recipe.n_components)
        sentences = [components.of(each) for each in frames]
        motion = np.concatenate(sentences)
        progress("speech manifold")
        manifold = speech_manifold(joint_parameters(sentences), recipe.n_landmarks)
        progress(f"{recipe.n_states} states in {manifold.shape[1]} dimensions")
        states = bisected_states(manifold, recipe.n_states, recipe.seed)
        speeds = np.concatenate([velocities(x) for x in sentences])
        means, covariances = state_gaussians(
            motion, speeds, states, recipe.n_states, recipe.shrinkage
        )
    return StateModel(
        frame_rate_hz=frame_rate_hz,
        borders=borders,
        cepstra=np.concatenate(cepstra).astype(np.float32),
        states=states,
        units=_units(utterances, borders),
        follows=transitions(
            [states[r.start : r.stop] for r in frames_between(borders)], recipe.n_states
        ),
        means=means,
        covariances=covariances,
        mean_mm=components.mean_mm,
        basis=components.basis,
    )


def _units(utterances: Sequence[Utterance], borders: Array) -> Units:
    phonemes, first, end = [], [], []
    for utterance, start in zip(utterances, borders, strict=False):
        n_frames = len(utterance.markers_mm)
        phones = joined_phones(utterance.phones, n_frames / utterance.frame_rate_hz)
        spans = unit_spans(phones, n_frames, utterance.frame_rate_hz)
        phonemes += [PHONEMES.index(p) for p in spans.phonemes]
        first.append(spans.first + start)
        end.append(spans.end + start)
    return Units(np.array(phonemes), np.concatenate(first), np.concatenate(end))


def _check_numbers(recipe: Recipe, n_frames: int, n_coordinates: int) -> None:
    if n_frames < 2 * recipe.n_states:
        raise BuildingError(
            f"{n_frames} frames are too few for {recipe.n_states} states: record more, or ask "
            f"for {n_frames // 2} at most (--states)"
        )
    most = min(n_frames - 1, n_coordinates)
    if recipe.n_components > most:
        raise BuildingError(
            f"{recipe.n_components} components: {n_frames} frames of {n_coordinates // 3} points "
            f"have {most} at most (--components)"
        )


def _flat(utterance: Utterance) -> NDArray[np.float32]:
    """(n_frames, 3 n_points), without a copy: dense scans take a gigabyte."""
    return utterance.markers_mm.reshape(len(utterance.markers_mm), -1)
