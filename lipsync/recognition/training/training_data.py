"""From aligned speech to the arrays that the network learns from.

Every utterance is heard in several ways (`augmentation`); each way of the whole corpus is one long
array, every utterance beginning as a stream does, with a fresh level and mean.
"""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

import numpy as np
from numpy.typing import NDArray

from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.corpus.transcribed import TranscribedUtterance
from lipsync.phonemes import PHONEMES, SILENCE
from lipsync.recognition.alignment.alignment_cache import AlignedUtterance
from lipsync.recognition.features import (
    FRAMES_PER_S,
    HOP,
    FeatureScale,
    LevelNormalizer,
    LogMelStream,
)
from lipsync.recognition.speech_file import read_speech
from lipsync.recognition.training import augmentation, noise
from lipsync.recognition.training.augmentation import Heard

#: Targets of frames that a head cannot know yet; torch's cross entropy passes over them.
NO_TARGET = -100
#: Silence put behind every utterance, so that late heads learn its last phones.
_TAIL_S = 0.15
#: One noise without speech for so many utterances.
_UTTERANCES_PER_NOISE = 8
_NOISE_S = 4.0


@dataclass(frozen=True, slots=True)
class TrainingArray:
    """One way to hear the whole corpus.

    features: (n, 40) float16; targets: (n, n_heads), the phoneme's number for each head's delay.
    """

    features: NDArray[np.float16]
    targets: NDArray[np.int64]


def read_heard(utterance: TranscribedUtterance, aligned: AlignedUtterance) -> Heard:
    """The utterance's samples, with a tail of silence, and labels."""
    samples = read_speech(utterance.sound)
    samples = np.concatenate((samples, np.zeros(round(_TAIL_S * SAMPLE_RATE_HZ), np.float32)))
    return Heard(samples, aligned.labels(len(samples) // HOP))


def feature_scale(recordings: Iterable[Heard]) -> FeatureScale:
    """What is typical of these recordings."""
    return FeatureScale.of(LogMelStream().push(heard.samples) for heard in recordings)


def delayed(labels: NDArray[np.int64], n_frames: int, delays: Sequence[int]) -> NDArray[np.int64]:
    """Targets (n_frames, n_heads): what head h says at frame n is the label of frame n - delay."""
    targets = np.full((n_frames, len(delays)), NO_TARGET)
    for head, delay in enumerate(delays):
        n_known = min(n_frames - delay, len(labels))
        targets[delay : delay + n_known, head] = labels[:n_known]
    return targets


def as_array(
    recordings: Iterable[Heard], scale: FeatureScale, delays: Sequence[int]
) -> TrainingArray:
    """All recordings one after the other, each heard as a stream of its own."""
    features, targets = [], []
    for heard in recordings:
        frames = LevelNormalizer(scale).push(LogMelStream().push(heard.samples))
        features.append(frames.astype(np.float16))
        targets.append(delayed(heard.labels, len(frames), delays))
    return TrainingArray(np.concatenate(features), np.concatenate(targets))


def training_arrays(
    clean: Sequence[Heard],
    scale: FeatureScale,
    delays: Sequence[int],
    *,
    n_heavy: int,
    seed: int,
    n_processes: int = 1,
    progress: Callable[[int], None] = lambda _n: None,
) -> list[TrainingArray]:
    """The corpus heard lightly once and heavily `n_heavy` times; the same seed, the same arrays."""
    jobs = [(copy, seed, scale, tuple(delays)) for copy in range(1 + n_heavy)]
    arrays: list[TrainingArray] = []
    _SHARED[:] = clean
    if n_processes <= 1:
        for job in jobs:
            arrays.append(_one_array(job))
            progress(len(arrays))
        return arrays
    # Forked workers see the recordings without copying them.
    with ProcessPoolExecutor(n_processes, mp_context=get_context("fork")) as pool:
        for array in pool.map(_one_array, jobs):
            arrays.append(array)
            progress(len(arrays))
    return arrays


_SHARED: list[Heard] = []


def _one_array(job: tuple[int, int, FeatureScale, tuple[int, ...]]) -> TrainingArray:
    copy, seed, scale, delays = job
    return as_array(_ways(_SHARED, copy, seed), scale, delays)


def _ways(clean: Sequence[Heard], copy: int, seed: int) -> Iterable[Heard]:
    babble = noise.babble([heard.samples for heard in clean[:: max(1, len(clean) // 200)]])
    silence = PHONEMES.index(SILENCE)
    for index, heard in enumerate(clean):
        rng = np.random.default_rng([seed, copy, index])
        if copy == 0:
            yield augmentation.lightly(rng, heard)
        else:
            yield augmentation.heavily(rng, heard, babble)
        if index % _UTTERANCES_PER_NOISE == 0:
            n_frames = round(_NOISE_S * FRAMES_PER_S)
            samples = augmentation.no_speech(rng, n_frames * HOP)
            yield Heard(samples, np.full(n_frames, silence))
