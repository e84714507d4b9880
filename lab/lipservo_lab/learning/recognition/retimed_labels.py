"""A teacher's labels: the phones of an alignment, laid anew over a better network's posteriors.

The aligner's boundaries are the ceiling of what learns from them. A network that waits long (it
knows what comes as well as what was) is trained on them, and its posteriors say where the same
phones are likelier to lie: Viterbi over the phones in order, each of two frames at least, silences
of which may be left out. What the network cannot find there was not spoken.
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
#: States of each phone; the last one repeats. From a first one back over a silence; the ways into a
#: state: it stays, from the one before, over a silence.
_STATES = 2
_OVER = 1 + _STATES
_STEPS = np.array([0, 1, _OVER], np.int8)


@dataclass(frozen=True, slots=True)
class TaughtRecordings:
    """Recordings with a teacher's labels, and what it says of each frame of them, in this order."""

    recordings: tuple[LabelledSamples, ...]
    taught: Taught
    n_unspoken: int


def taught_by(
    teacher: NetworkWeights,
    recordings: Sequence[tuple[LabelledSamples, AlignedUtterance]],
    progress: Callable[[int], None] = lambda _n: None,
) -> TaughtRecordings:
    """Align the phones of recordings anew by a teacher's posteriors.

    A recording in which the teacher does not find the phones is left out: its score, the mean log
    ratio of the aligned phone to the likeliest (`goodness_of_pronunciation`), is below
    `LEAST_SCORE`.
    """
    kept: list[LabelledSamples] = []
    posteriors: list[NDArray[np.float16]] = []
    for number, (recording, aligned) in enumerate(recordings, start=1):
        heard = _posteriors(teacher, recording)
        labels = labels_if_spoken([PHONEME_INDEX[name] for name, _, _ in aligned.phones], heard)
        if labels is not None:
            kept.append(replace(recording, labels=labels))
            posteriors.append(heard.astype(np.float16))
        progress(number)
    nothing = np.zeros(0, np.int64)
    taught = Taught(
        np.concatenate([nothing, *(each.labels for each in kept)]),
        np.concatenate([np.zeros((0, len(PHONEMES)), np.float16), *posteriors]),
    )
    return TaughtRecordings(tuple(kept), taught, len(recordings) - len(kept))


def labels_if_spoken(phones: Sequence[int], posteriors: Array32) -> NDArray[np.int64] | None:
    """Return labels laid anew by a teacher's posteriors; None where the phones are not there.

    Parameters
    ----------
    phones : Sequence[int]
        Numbers as in PHONEMES.
    posteriors : Array32
        (n, n_phonemes).

    Returns
    -------
    NDArray[np.int64] | None
        (n,); None where the phones do not fit in, or score below `LEAST_SCORE`.
    """
    logs = np.log(np.maximum(posteriors, np.float32(_SMALLEST)))
    labels = retimed(phones, logs)
    return labels if labels is not None and _score(labels, logs) >= LEAST_SCORE else None


def retimed(phones: Sequence[int], logs: Array32) -> NDArray[np.int64] | None:
    """Return the likeliest labels that have the phones in order.

    Silence may stand before and after everything.

    Parameters
    ----------
    phones : Sequence[int]
        Numbers as in PHONEMES.
    logs : Array32
        (n, n_phonemes), log posteriors.

    Returns
    -------
    NDArray[np.int64] | None
        (n,); None where they do not fit in.
    """
    whole = np.array([_SILENCE_INDEX, *phones, _SILENCE_INDEX])
    is_silence = whole == _SILENCE_INDEX
    is_more_silence = is_silence & np.concatenate(([False], is_silence[:-1]))
    states = np.repeat(whole[~is_more_silence], _STATES)
    n, n_states = len(logs), len(states)
    is_last = np.arange(n_states) % _STATES == _STATES - 1
    # Into a phone's first state, from the last one before a silence.
    is_over = np.zeros(n_states, bool)
    is_over[_OVER:] = ~is_last[_OVER:] & (states[_OVER - _STATES : -_STATES] == _SILENCE_INDEX)
    nowhere = np.full(_OVER, np.inf)
    best = np.full(n_states, np.inf)
    best[[0, *([_STATES] if n_states > _STATES else [])]] = 0.0
    best -= logs[0, states]
    steps = np.zeros((n, n_states), np.int8)
    for frame in range(1, n):
        ways = np.stack(
            (
                np.where(is_last, best, np.inf),
                np.concatenate((nowhere[:1], best[:-1])),
                np.where(is_over, np.concatenate((nowhere, best))[:n_states], np.inf),
            )
        )
        chosen = ways.argmin(axis=0)
        steps[frame] = _STEPS[chosen]
        best = ways[chosen, np.arange(n_states)] - logs[frame, states]
    ends = [n_states - 1, *([n_states - 1 - _STATES] if n_states > _STATES else [])]
    at = min(ends, key=lambda state: best[state])
    if not np.isfinite(best[at]):
        return None
    path = np.empty(n, np.int64)
    for frame in range(n - 1, -1, -1):
        path[frame] = at
        at -= int(steps[frame, at])
    return np.asarray(states[path], np.int64)


def _posteriors(teacher: NetworkWeights, recording: LabelledSamples) -> Array32:
    """Return the posteriors of the head with the longest delay, (n_frames, n_phonemes)."""
    n_frames, delay = len(recording.labels), teacher.delays[-1]
    return recording_posteriors(teacher, recording.samples, n_frames + delay)[delay:, -1]


def _score(labels: NDArray[np.int64], logs: Array32) -> float:
    spoken = (labels != _SILENCE_INDEX) | (logs.argmax(axis=1) != _SILENCE_INDEX)
    ratio = logs[np.arange(len(logs)), labels] - logs.max(axis=1)
    return float(ratio[spoken].mean()) if spoken.any() else 0.0
