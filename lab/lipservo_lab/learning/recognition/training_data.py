"""From aligned speech to the arrays and windows that the network learns from; the training plan.

Every utterance is augmented several times (`augmentation`). Each copy of the corpus is one long
array, in which every utterance begins as a new stream, with a fresh level and mean.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from multiprocessing import get_context

import numpy as np
from numpy.typing import NDArray

from lipservo_lab.corpus.alignment_cache import AlignedUtterance
from lipservo_lab.corpus.transcribed import TranscribedUtterance
from lipservo_lab.learning.recognition import augmentation, noise
from lipservo_lab.learning.recognition.augmentation import LabelledSamples, Surroundings
from lipservo_lab.learning.recognition.noise import found
from lipservo_lab.learning.recognition.nonspeech_sounds import laughter_of
from lipservo_lab.worker_pool import worker_pool
from lipsync.arrays import Array32
from lipsync.audio.file import read_speech
from lipsync.audio_block import SAMPLE_RATE_HZ
from lipsync.errors import UserError
from lipsync.phonemes import PHONEMES, SILENCE
from lipsync.recognition.features import (
    FRAMES_PER_S,
    HOP,
    N_BANDS,
    FeatureScale,
    LevelNormalizer,
    LogMelStream,
)
from lipsync.recognition.network import NetworkWeights

#: Targets of frames that a head cannot know yet; torch's cross entropy passes over them.
NO_TARGET = -100
#: Silence put behind every utterance, so that late heads learn its last phones.
_TAIL_S = 0.15
#: Utterances for each sound without speech, which makes these sounds a seventh of the time.
_UTTERANCES_PER_SOUND = 2
_SOUND_S = 3.0
#: Of so many copies one is without noise, so that quiet rooms stay the commonest.
_LIGHT_EVERY = 4


@dataclass(frozen=True, slots=True)
class TrainingArray:
    """One augmented copy of the whole corpus.

    features: (n, 40) float16; targets: (n, n_heads), the phoneme index that each head shall output
    at each frame, NO_TARGET where it has none.
    """

    features: NDArray[np.float16]
    targets: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Taught:
    """A teacher's labels and posteriors of the frames of all recordings, one after the other.

    labels: (n,), posteriors: (n, n_phonemes) float16. A target of len(PHONEMES) + i stands for
    frame i of these: so changes of speed move posteriors with their labels, and they are stored
    once, not once a copy.
    """

    labels: NDArray[np.int64]
    posteriors: NDArray[np.float16]


def read_labelled(utterance: TranscribedUtterance, aligned: AlignedUtterance) -> LabelledSamples:
    """Return the utterance's samples, with 150 ms of silence behind them, and its labels.

    Raises SoundError for a sound that cannot be read.
    """
    samples = read_speech(utterance.sound)
    samples = np.concatenate((samples, np.zeros(round(_TAIL_S * SAMPLE_RATE_HZ), np.float32)))
    return LabelledSamples(samples, aligned.labels(len(samples) // HOP))


def feature_scale(recordings: Iterable[LabelledSamples]) -> FeatureScale:
    """Return the mean and scale of features over all recordings."""
    return FeatureScale.of(LogMelStream().push(recording.samples) for recording in recordings)


def delayed(labels: NDArray[np.int64], n_frames: int, delays: Sequence[int]) -> NDArray[np.int64]:
    """Return the targets of all heads: at frame i, for delay d, the label of frame i - d.

    Parameters
    ----------
    labels : NDArray[np.int64]
        (m,), of frames.
    n_frames : int
        Number of frames of the targets.
    delays : Sequence[int]
        Of the heads, in frames.

    Returns
    -------
    NDArray[np.int64]
        (n_frames, n_heads); NO_TARGET for frames before the first label or after the last.
    """
    targets = np.full((n_frames, len(delays)), NO_TARGET)
    for head, delay in enumerate(delays):
        n_known = min(n_frames - delay, len(labels))
        targets[delay : delay + n_known, head] = labels[:n_known]
    return targets


def as_array(
    recordings: Iterable[LabelledSamples], scale: FeatureScale, delays: Sequence[int]
) -> TrainingArray:
    """Join recordings one after the other, each as a stream of its own.

    Parameters
    ----------
    recordings : Iterable[LabelledSamples]
        Samples with labels.
    scale : FeatureScale
        Scale of the features.
    delays : Sequence[int]
        Of the heads, in frames.

    Returns
    -------
    TrainingArray
        Features (n, 40), targets (n, n_heads).
    """
    features, targets = [], []
    for recording in recordings:
        frames = LevelNormalizer(scale).push(LogMelStream().push(recording.samples))
        features.append(frames.astype(np.float16))
        targets.append(delayed(recording.labels, len(frames), delays))
    return TrainingArray(np.concatenate(features), np.concatenate(targets))


def training_arrays(
    clean: Sequence[LabelledSamples],
    scale: FeatureScale,
    delays: Sequence[int],
    *,
    n_heavy: int,
    seed: int,
    found_sounds: Sequence[Array32] = (),
    is_taught: bool = False,
    n_processes: int = 1,
) -> Iterator[TrainingArray]:
    """Yield one lightly and `n_heavy` heavily augmented copies of the corpus, as they are made.

    The same arguments give the same arrays.

    Parameters
    ----------
    clean : Sequence[LabelledSamples]
        The recordings.
    scale : FeatureScale
        Scale of the features.
    delays : Sequence[int]
        Of the heads, in frames.
    n_heavy : int
        Number of heavily augmented copies.
    seed : int
        Seed of the augmentation.
    found_sounds : Sequence[Array32]
        Recordings (n,) without speech, beside synthetic sounds.
    is_taught : bool
        Whether targets are frames of a `Taught` of `clean` in this order, in place of labels.
    n_processes : int
        Number of copies made at once.

    Returns
    -------
    Iterator[TrainingArray]
        Features (n, 40), targets (n, n_heads).
    """
    jobs = [(copy, seed, scale, tuple(delays)) for copy in range(1 + n_heavy)]
    _SHARED[:] = clean
    _FOUND[:] = found_sounds
    ends = np.cumsum([len(each.labels) for each in clean]) if is_taught else np.zeros(0, np.int64)
    _TAUGHT_ENDS[:] = ends.tolist()
    if n_processes <= 1:
        yield from map(_training_array, jobs)
        return
    # Forked workers see the recordings without copying them.
    with worker_pool(n_processes, get_context("fork")) as pool:
        yield from pool.map(_training_array, jobs)


_SHARED: list[LabelledSamples] = []
_FOUND: list[Array32] = []
#: Frames up to the end of each recording; empty where nobody teaches.
_TAUGHT_ENDS: list[int] = []


def _training_array(job: tuple[int, int, FeatureScale, tuple[int, ...]]) -> TrainingArray:
    """Return the array of one copy.

    job: number of the copy, seed, scale of features, delays. The recordings are in `_SHARED`, since
    a forked process has them without copying.
    """
    copy, seed, scale, delays = job
    return as_array(_augmented(_SHARED, copy, seed), scale, delays)


def _augmented(clean: Sequence[LabelledSamples], copy: int, seed: int) -> Iterable[LabelledSamples]:
    """Return one augmented copy of the corpus.

    With a teacher, labels are not phonemes but numbers of the teacher's frames plus len(PHONEMES).
    """
    around = surroundings(clean, _FOUND)
    if _TAUGHT_ENDS:
        clean = [
            replace(recording, labels=len(PHONEMES) + np.arange(end - len(recording.labels), end))
            for recording, end in zip(clean, _TAUGHT_ENDS, strict=True)
        ]
    return disturbed_copy(clean, around, copy, seed)


def surroundings(
    clean: Sequence[LabelledSamples], found_sounds: Sequence[Array32] = ()
) -> Surroundings:
    """Return makers of sounds beside speech; voices and laughter are of at most 400 recordings.

    Parameters
    ----------
    clean : Sequence[LabelledSamples]
        Recordings of speech at 16 kHz.
    found_sounds : Sequence[Array32]
        Recordings (n,) at 16 kHz without speech; none: only synthetic sounds.

    Returns
    -------
    Surroundings
        Makers of sounds.
    """
    chosen = clean[:: max(1, len(clean) // 200)]
    voices = [recording.samples for recording in chosen]
    return Surroundings(
        noise.babble(voices),
        noise.babble(voices, 1),
        laughter_of([(recording.samples, recording.labels) for recording in chosen]),
        found(list(found_sounds)) if found_sounds else None,
    )


def disturbed_copy(
    clean: Sequence[LabelledSamples], around: Surroundings, copy: int, seed: int
) -> Iterator[LabelledSamples]:
    """Yield each recording augmented, and after every second one a sound of 3 s without speech.

    Parameters
    ----------
    clean : Sequence[LabelledSamples]
        Recordings of speech at 16 kHz.
    around : Surroundings
        Makers of sounds beside speech.
    copy : int
        Number of the copy. Copy 0 has other levels, every fourth one other levels and voices; the
        others are augmented heavily.
    seed : int
        Of all draws, with `copy` and the recording's index.

    Yields
    ------
    LabelledSamples
        At 16 kHz, a label every 10 ms.
    """
    silence = np.full(round(_SOUND_S * FRAMES_PER_S), PHONEMES.index(SILENCE))
    for index, recording in enumerate(clean):
        rng = np.random.default_rng([seed, copy, index])
        if copy == 0:
            yield augmentation.augment_lightly(rng, recording)
        elif copy % _LIGHT_EVERY == 0:
            yield augmentation.augment_lightly(rng, augmentation.by_another_voice(rng, recording))
        else:
            yield augmentation.augment_heavily(rng, recording, around)
        if index % _UTTERANCES_PER_SOUND == 0:
            samples = augmentation.no_speech(rng, len(silence) * HOP, around)
            yield LabelledSamples(samples, silence)


#: Chance that a window is drawn from the lightly changed copy; the heavily changed share the rest.
_LIGHT_SHARE = 0.25
#: In half of the windows, fewer than this many neighbouring bands are blanked.
MASKED_BANDS = 8


class TrainingError(UserError):
    """There is nothing to learn from, or the parts do not fit; the message is one line."""


@dataclass(frozen=True, slots=True)
class TrainingPlan:
    """How to train; the defaults are those of `lipservo learn recognizer`.

    delays: of the heads, in frames; head_weights: of the heads in the loss. dilations: of the
    residual layers; the network sees 2 sum(dilations) + 2 frames back. batch: windows a step;
    window: frames in each. closure_weight: of a frame of P B M or F V in the loss of the viseme
    classes: everybody sees a missed closure, few see one too many. visible_weight: of the visible
    error in mm that the posteriors lead to on average (`visible_error`). soft_share: of a teacher's
    posteriors in place of labels, for frames that have them. log_every, check_every: in steps.
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
    visible_weight: float = 0.0
    soft_share: float = 0.5
    seed: int = 0
    n_threads: int = 2
    log_every: int = 50
    check_every: int = 100

    @property
    def averaging(self) -> float:
        """Share of the running average that stays at each step; it spans a quarter of the run."""
        return 1.0 - 4.0 / max(8, self.n_steps)

    def shaped_as(self, weights: NetworkWeights) -> "TrainingPlan":
        """Return the plan for a network with the delays, dilations and channels of `weights`."""
        return replace(
            self,
            delays=weights.delays,
            dilations=tuple(layer.dilation for layer in weights.residuals),
            channels=len(weights.entry.bias),
        )

    def with_delays(self, delays: tuple[int, ...]) -> "TrainingPlan":
        """Return the plan with other delays; if they are not the default, all heads weigh alike."""
        weights = self.head_weights
        if delays != TrainingPlan().delays:
            weights = (1.0 / len(delays),) * len(delays)
        return replace(self, delays=delays, head_weights=weights)


def draw_windows(
    arrays: Sequence[TrainingArray], plan: TrainingPlan, rng: np.random.Generator
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Draw windows of the arrays; in half of them some neighbouring bands are set to 0.

    Parameters
    ----------
    arrays : Sequence[TrainingArray]
        Features of shape (n, 40), and targets; the first is the lightly changed copy.
    plan : TrainingPlan
        Number and length of windows.
    rng : np.random.Generator
        Draws arrays, places and bands.

    Returns
    -------
    tuple[NDArray[np.float32], NDArray[np.int64]]
        Features (batch, 40, window); targets (batch, n_heads, window).
    """
    features = np.empty((plan.batch, N_BANDS, plan.window), np.float32)
    targets = np.empty((plan.batch, len(plan.delays), plan.window), np.int64)
    for index in range(plan.batch):
        is_heavy = len(arrays) > 1 and rng.random() > _LIGHT_SHARE
        array = arrays[int(rng.integers(1, len(arrays)))] if is_heavy else arrays[0]
        first = int(rng.integers(0, max(1, len(array.features) - plan.window)))
        frames = slice(first, first + plan.window)
        features[index] = array.features[frames].T
        targets[index] = array.targets[frames].T
        if rng.random() < 0.5:
            band = int(rng.integers(0, N_BANDS - MASKED_BANDS))
            features[index, band : band + int(rng.integers(1, MASKED_BANDS))] = 0.0
    return features, targets
