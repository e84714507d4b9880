"""A teacher's labels: the phones of an alignment, timed anew by a better network's posteriors.

A network cannot learn better phone boundaries than the aligner's that it is trained on. So a
network with long delays (a teacher: it also uses the sound after a frame) is trained on them, and
its posteriors say where the same phones more likely lie: by Viterbi over the phones in order, each
two frames long at least; silences may be left out. Recordings whose phones the teacher does not
find are left out, as other words were spoken.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lipservo_lab.corpus.alignment_cache import PHONEME_INDEX, AlignedUtterance
from lipservo_lab.learning.recognition.augmentation import LabelledSamples
from lipservo_lab.learning.recognition.training_data import Taught
from lipsync.arrays import Array32
from lipsync.phonemes import PHONEMES, SILENCE
from lipsync.recognition.alignment import LEAST_SCORE
from lipsync.recognition.batch import recording_posteriors
from lipsync.recognition.network import NetworkWeights

_SMALLEST = 1e-6
_SILENCE_INDEX = PHONEME_INDEX[SILENCE]
#: States of each phone; the last one repeats. _OVER: how many states lie between a phone's first
#: state and the last state of the phone before a silence. _STEPS: by how many states a path
#: advances: it stays, moves to the next state, or skips a silence.
_STATES = 2
_OVER = 1 + _STATES
_STEPS = np.array([0, 1, _OVER], np.int8)


@dataclass(frozen=True, slots=True)
class TaughtRecordings:
    """Recordings with a teacher's labels.

    taught: the teacher's labels and posteriors of all their frames, in this order. n_unspoken:
    number of recordings that were left out because the teacher does not find their phones.
    """

    recordings: tuple[LabelledSamples, ...]
    taught: Taught
    n_unspoken: int


def taught_by(
    teacher: NetworkWeights,
    recordings: Sequence[tuple[LabelledSamples, AlignedUtterance]],
    progress: Callable[[int], None] = lambda _n: None,
) -> TaughtRecordings:
    """Return recordings with phones timed anew by a teacher's posteriors, and these posteriors.

    progress: called with the number of recordings done. A recording in which the teacher does not
    find the phones is left out: its score, the mean log ratio of the aligned phone to the likeliest
    (`goodness_of_pronunciation`), is below `LEAST_SCORE`.
    """
    relabelled: list[LabelledSamples] = []
    posteriors: list[NDArray[np.float16]] = []
    for number, (recording, aligned) in enumerate(recordings, start=1):
        probs = _posteriors(teacher, recording)
        labels = labels_if_spoken([PHONEME_INDEX[name] for name, _, _ in aligned.phones], probs)
        if labels is not None:
            relabelled.append(replace(recording, labels=labels))
            posteriors.append(probs.astype(np.float16))
        progress(number)
    no_labels = np.zeros(0, np.int64)
    taught = Taught(
        np.concatenate([no_labels, *(each.labels for each in relabelled)]),
        np.concatenate([np.zeros((0, len(PHONEMES)), np.float16), *posteriors]),
    )
    return TaughtRecordings(tuple(relabelled), taught, len(recordings) - len(relabelled))


def labels_if_spoken(phones: Sequence[int], posteriors: Array32) -> NDArray[np.int64] | None:
    """Return labels timed by a teacher's posteriors; None where the phones were not spoken.

    Parameters
    ----------
    phones : Sequence[int]
        Indices in PHONEMES, in order.
    posteriors : Array32
        (n, n_phonemes).

    Returns
    -------
    NDArray[np.int64] | None
        (n,) indices in PHONEMES; None where n frames are too few for the phones, or where they
        score below `LEAST_SCORE`.
    """
    logs = np.log(np.maximum(posteriors, np.float32(_SMALLEST)))
    labels = retimed(phones, logs)
    return labels if labels is not None and _score(labels, logs) >= LEAST_SCORE else None


def retimed(phones: Sequence[int], logs: Array32) -> NDArray[np.int64] | None:
    """Return the likeliest labels of frames in which the phones follow each other in order.

    Silence may stand before and after all phones. By Viterbi.

    Parameters
    ----------
    phones : Sequence[int]
        Indices in PHONEMES; silences among them may be skipped.
    logs : Array32
        (n, n_phonemes), log posteriors.

    Returns
    -------
    NDArray[np.int64] | None
        (n,) indices in PHONEMES; None where n frames are too few.
    """
    with_silences = np.array([_SILENCE_INDEX, *phones, _SILENCE_INDEX])
    is_silence = with_silences == _SILENCE_INDEX
    repeats_silence = is_silence & np.concatenate(([False], is_silence[:-1]))
    states = np.repeat(with_silences[~repeats_silence], _STATES)
    n, n_states = len(logs), len(states)
    is_last = np.arange(n_states) % _STATES == _STATES - 1
    # States that can be reached over a silence: the first state of the phone behind one.
    may_skip = np.zeros(n_states, bool)
    may_skip[_OVER:] = ~is_last[_OVER:] & (states[_OVER - _STATES : -_STATES] == _SILENCE_INDEX)
    no_way = np.full(_OVER, np.inf)
    # Cost of the cheapest path that ends in each state: negative log posteriors, summed.
    costs = np.full(n_states, np.inf)
    # A path begins in the first silence or in the phone after it.
    costs[[0, *([_STATES] if n_states > _STATES else [])]] = 0.0
    costs -= logs[0, states]
    back_steps = np.zeros((n, n_states), np.int8)
    for frame in range(1, n):
        candidates = np.stack(
            (
                np.where(is_last, costs, np.inf),
                np.concatenate((no_way[:1], costs[:-1])),
                np.where(may_skip, np.concatenate((no_way, costs))[:n_states], np.inf),
            )
        )
        chosen = candidates.argmin(axis=0)
        back_steps[frame] = _STEPS[chosen]
        costs = candidates[chosen, np.arange(n_states)] - logs[frame, states]
    # A path ends in the last silence or in the phone before it.
    ends = [n_states - 1, *([n_states - 1 - _STATES] if n_states > _STATES else [])]
    at_state = min(ends, key=lambda state: costs[state])
    if not np.isfinite(costs[at_state]):
        return None
    path = np.empty(n, np.int64)
    for frame in range(n - 1, -1, -1):
        path[frame] = at_state
        at_state -= int(back_steps[frame, at_state])
    return np.asarray(states[path], np.int64)


def _posteriors(teacher: NetworkWeights, recording: LabelledSamples) -> Array32:
    """Return the posteriors of the head with the longest delay, (n_frames, n_phonemes)."""
    n_frames, delay = len(recording.labels), teacher.delays[-1]
    return recording_posteriors(teacher, recording.samples, n_frames + delay)[delay:, -1]


def _score(labels: NDArray[np.int64], logs: Array32) -> float:
    """Return the mean log ratio of the labels' posteriors to those of the likeliest phonemes.

    labels: (n,); logs: (n, n_phonemes). Frames in which label and likeliest phoneme are both
    silence do not count; 0 if no frame counts.
    """
    spoken = (labels != _SILENCE_INDEX) | (logs.argmax(axis=1) != _SILENCE_INDEX)
    ratio = logs[np.arange(len(logs)), labels] - logs.max(axis=1)
    return float(ratio[spoken].mean()) if spoken.any() else 0.0
