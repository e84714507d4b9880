"""The phonemes that the live recogniser would report as final, for whole recordings. Offline.

The arithmetic is that of `NetworkRecognizer`, but the network takes a recording in one go, and the
decoder goes forward frame by frame through many recordings side by side.
"""

from collections.abc import Iterator, Sequence
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from lipsync.arrays import Array32
from lipsync.phonemes import PHONEMES, PhonemeEvent
from lipsync.recognition.decoder import (
    PAUSE_FRAMES,
    SILENCE_INDEX,
    SMOOTH,
    best_heads,
    change_penalties,
    log_scores,
)
from lipsync.recognition.features import FRAMES_PER_S, HOP, WINDOW
from lipsync.recognition.network import LATENCY_S, NetworkWeights
from lipsync.recognition.network_recognizer import delay_frames, patience_frames
from lipsync.recognition.posteriors import PosteriorStream

#: Recordings side by side: enough that NumPy's own cost does not count, in little memory.
TOGETHER = 64
#: Silence after the longest, until its last phoneme is settled, s.
_TAIL_S = 0.5


def settled_phonemes(
    weights: NetworkWeights, recordings: Sequence[Array32], latency_s: float = LATENCY_S
) -> Iterator[tuple[PhonemeEvent, ...]]:
    """Yield the phonemes of each recording that the live recogniser would report as final.

    Parameters
    ----------
    weights : NetworkWeights
        Weights of the network.
    recordings : Sequence[Array32]
        (n,) samples each at 16 kHz.
    latency_s : float
        Latency of the live recogniser, s.

    Returns
    -------
    Iterator[tuple[PhonemeEvent, ...]]
        The phonemes of each recording, without gaps from 0 to its end.
    """
    delay = delay_frames(latency_s)
    delay += patience_frames(delay, weights.delays)
    for first in range(0, len(recordings), TOGETHER):
        batch = recordings[first : first + TOGETHER]
        n_frames = max(len(samples) for samples in batch) // HOP + round(_TAIL_S * FRAMES_PER_S)
        posteriors = np.stack([recording_posteriors(weights, s, n_frames + delay) for s in batch])
        labels = _settled(posteriors, weights.delays, delay)
        for samples, settled in zip(batch, labels, strict=True):
            yield _events(settled[: max(1, -(-len(samples) // HOP))])


def recording_posteriors(weights: NetworkWeights, samples: Array32, n_frames: int) -> Array32:
    """Return the network's posteriors of a recording, which is padded with silence to `n_frames`.

    Parameters
    ----------
    weights : NetworkWeights
        Weights of the network.
    samples : Array32
        (n,) at 16 kHz.
    n_frames : int
        Number of frames of 10 ms.

    Returns
    -------
    Array32
        (n_frames, n_heads, n_phonemes); in frame k the head that waits d frames gives frame k - d.
    """
    padded = np.zeros((n_frames - 1) * HOP + WINDOW, np.float32)
    padded[: len(samples)] = samples
    return PosteriorStream(weights).push(padded)


def _settled(posteriors: Array32, delays: tuple[int, ...], delay: int) -> NDArray[np.int64]:
    """Return the phonemes that `ViterbiDecoder` would settle, (n_recordings, n_frames - delay).

    posteriors: (n_recordings, n_frames, n_heads, n_phonemes). delays: frames that each head waits.
    A frame is settled `delay` frames later, by the best path through the frames heard since.
    """
    scores = log_scores(posteriors, SMOOTH)
    penalties = change_penalties(SMOOTH)
    heads = best_heads(delays, delay)
    n_recordings, n_frames, _, n_phonemes = posteriors.shape
    rows, states = np.arange(n_recordings), np.arange(n_phonemes)
    labels = np.empty((n_recordings, n_frames - delay), np.int64)

    def step(best: Array32, frame: int, age: int) -> tuple[Array32, NDArray[np.int64]]:
        """Advance the best paths by frame number `frame`; return new scores, and their sources.

        best: path scores (n_recordings, n_phonemes) in the frame before. age: frames heard after
        `frame`, which chooses the head. sources: of each path, its phoneme in the frame before.
        """
        head = heads[age - delays[0]]
        leader = best.argmax(axis=1)
        is_waking = (leader == SILENCE_INDEX) & (n_silent >= PAUSE_FRAMES)
        changed = best[rows, leader][:, None] - penalties[is_waking.astype(np.int64)]
        stays = best >= changed
        source = np.where(stays, states, leader[:, None])
        return np.where(stays, best, changed) + scores[:, frame + delays[head], head], source

    settled = np.zeros((n_recordings, n_phonemes), np.float32)
    n_silent = np.full(n_recordings, PAUSE_FRAMES)
    for oldest in range(n_frames - delay):
        # The frame to be settled, then on through all later frames that a head has scored by now.
        best = step(settled, oldest, delay)[0]
        settled = best - best.max(axis=1, keepdims=True)
        sources = []
        for age in range(delay - 1, delays[0] - 1, -1):
            best, source = step(best, oldest + delay - age, age)
            sources.append(source)
        # Back along the best path, from the newest frame to the one to be settled.
        state = best.argmax(axis=1)
        path = [state]
        for source in reversed(sources):
            state = source[rows, state]
            path.append(state)
        # After a pause a frame is settled as speech only if the next ones known are speech too.
        nearest = np.stack(path[::-1][: SMOOTH.waking_frames])
        is_believed = (nearest != SILENCE_INDEX).all(axis=0)
        state = np.where((n_silent >= PAUSE_FRAMES) & ~is_believed, SILENCE_INDEX, state)
        n_silent = np.where(state == SILENCE_INDEX, n_silent + 1, 0)
        labels[:, oldest] = state
    return labels


def _events(labels: NDArray[np.int64]) -> tuple[PhonemeEvent, ...]:
    """Return the runs of equal labels, numbers in `PHONEMES` of 10 ms frames, as events."""
    events, start = [], 0
    for label, run in groupby(labels.tolist()):
        end = start + len(list(run))
        events.append(PhonemeEvent(PHONEMES[label], start / FRAMES_PER_S, end / FRAMES_PER_S))
        start = end
    return tuple(events)
