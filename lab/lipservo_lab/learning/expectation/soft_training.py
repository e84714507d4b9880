"""Learning what the mouth does by a recogniser's posteriors, of a voice disturbed in many ways.

The recordings are of few talkers; so every sentence is heard as it is and again as other voices in
other rooms would have spoken it (times stay), and its face is learned from the recogniser's
posteriors each time; and from those of others, older or adapted, where some are given. Frames are
seen as they are live: by the heads that have spoken of them when a look-ahead of 100 ms is over,
and on every other frame when there is less.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from threadpoolctl import threadpool_limits

from lipservo_lab.corpus.utterance import Utterance, speech_frames
from lipservo_lab.learning.expectation.deviation import gain_and_mean
from lipservo_lab.learning.expectation.expectation_training import (
    NEAR_SPEECH_S,
    Schedule,
    articulatory_features,
    fit,
    initial_layers,
)
from lipservo_lab.learning.recognition import noise
from lipservo_lab.learning.recognition.augmentation import warped
from lipsync.arrays import Array, Array32
from lipsync.audio.file import read_speech
from lipsync.audio.source import SoundError
from lipsync.errors import UserError
from lipsync.expectation.soft_expectation import (
    FRAMES_PER_S,
    OFFSETS,
    WINDOWS,
    SoftExpectation,
    window_means,
)
from lipsync.phonemes import PHONEMES, SILENCE, VISEME_CLASSES, VISEME_OF
from lipsync.recognition.features import HOP
from lipsync.recognition.network import NetworkWeights
from lipsync.recognition.posteriors import PosteriorStream

#: All frequencies times so much, or a few percent beside it; the first copy is the sentence itself.
_VOICES: Final = (1.0, 0.86, 0.93, 1.09, 1.18)
_VOICE_SPREAD = 0.03
#: Copies, and how many frames after one have been heard when its face is decided: with 100 ms of
#: look-ahead, with none, with that of --low-latency.
_SEEN: Final = ((0, 17), (1, 17), (2, 17), (3, 17), (4, 17), (0, 7), (1, 7), (2, 12))
_FULL_AHEAD = 17
#: Silence after a sentence, until the last head has spoken of its end, s.
_TAIL_S = 0.25
#: All chosen on two inner splits of left-out words (docs/decisions/motion.md).
_N_COSINES, _WIDTH, _RIDGE, _COSINE_SCALE = 600, 9.0, 300.0, 10.0
_HIDDEN, _SCHEDULE = (192, 48), Schedule(n_epochs=3, decay=0.004)
_SMALLEST_SPREAD = 0.05
#: Of the recorded deviation; more than the expectation's, since half of a mean is a mean again.
_DEVIATION = 0.95
#: With fewer rows nothing is learned.
_FEWEST = 2000


@dataclass(frozen=True, slots=True)
class HeardCopies:
    """Posteriors (n_frames, n_heads, n_phonemes) of sentences by name, a mapping for each voice.

    by_others: of the same voices, by other weights in turn; empty where there are none.
    """

    delays: tuple[int, ...]
    voices: tuple[Mapping[str, Array32], ...]
    by_others: tuple[Mapping[str, Array32], ...] = ()


def hear_copies(
    weights: NetworkWeights,
    utterances: Sequence[Utterance],
    progress: Callable[[str, Sequence[Utterance]], Iterable[Utterance]],
    others: Sequence[NetworkWeights] = (),
) -> HeardCopies:
    """Return a recogniser's posteriors of every sentence, in each of `_VOICES`.

    Sounds that cannot be read are left out. others: further weights; each voice is also recognised
    by one of them. Raises UserError where their delays differ from those of `weights`.
    """
    if any(other.delays != weights.delays for other in others):
        raise UserError(
            "recogniser weights that are used together must have the same delays: "
            + "; ".join(_delays_ms(each) for each in (weights, *others))
        )
    voices, by_others = [], []
    with threadpool_limits(limits=1):  # several threads add up in changing order
        for number, factor in enumerate(_VOICES):
            rng = np.random.default_rng(number)
            heard: dict[str, Array32] = {}
            heard_by_other: dict[str, Array32] = {}
            for utterance in progress(f"listening to voice {number + 1}", utterances):
                try:
                    samples = read_speech(utterance.sound_path)
                except SoundError:
                    continue
                samples = np.concatenate((samples, np.zeros(_tail(), np.float32)))
                if number:
                    samples = _disturbed(rng, samples, factor)
                heard[utterance.name] = _believed(weights, samples)
                if others:
                    other = others[number % len(others)]
                    heard_by_other[utterance.name] = _believed(other, samples)
            voices.append(heard)
            by_others += [heard_by_other] if others else []
    return HeardCopies(weights.delays, tuple(voices), tuple(by_others))


def _believed(weights: NetworkWeights, samples: Array32) -> Array32:
    """Posteriors in half precision: 60 MB a voice in place of 120, for 44 minutes."""
    return PosteriorStream(weights).push(samples).astype(np.float16)


def _delays_ms(weights: NetworkWeights) -> str:
    return ", ".join(f"{1000 * delay / FRAMES_PER_S:.0f}" for delay in weights.delays) + " ms"


def _tail() -> int:
    return round(_TAIL_S * FRAMES_PER_S) * HOP


def _disturbed(rng: np.random.Generator, samples: Array32, factor: float) -> Array32:
    """Return samples as another voice in another room at another level, of the same length."""
    spread = rng.uniform(1.0 - _VOICE_SPREAD, 1.0 + _VOICE_SPREAD)
    samples = warped(samples, factor * spread)
    if rng.random() < 0.4:
        samples = noise.reverberate(rng, samples)
    if rng.random() < 0.6:
        kind = noise.coloured if rng.random() < 0.5 else noise.white
        samples = noise.add_noise(samples, kind(rng, len(samples)), rng.uniform(10.0, 25.0))
    if rng.random() < 0.2:
        samples = noise.telephone(samples)
    return np.asarray(samples * 10.0 ** (rng.uniform(-12.0, 6.0) / 20.0), np.float32)


def looks() -> Array32:
    """Return articulation and viseme class, in which unknown words are familiar.

    Returns
    -------
    Array32
        (n_phonemes, k).
    """
    classes = np.eye(len(VISEME_CLASSES))[[VISEME_OF[phoneme] for phoneme in PHONEMES]]
    return np.concatenate([articulatory_features(), classes], axis=1).astype(np.float32)


def believed_means(values: Array32, delays: Sequence[int], frames: Array, ahead: int) -> Array32:
    """Return mean posteriors around frames, as they are live `ahead` frames later.

    Before the first frame there was silence; where no head has spoken it is 0.

    Parameters
    ----------
    values : Array32
        (n_frames, n_heads, n_phonemes).
    delays : Sequence[int]
        Of the heads, in frames.
    frames : Array
        (n,).
    ahead : int
        Frames.

    Returns
    -------
    Array32
        (n, n_windows, n_phonemes).
    """
    wanted = frames.astype(np.int64)[:, None] + OFFSETS
    rows = np.zeros((*wanted.shape, values.shape[2]), np.float32)
    for head, delay in enumerate(delays):
        columns = np.flatnonzero(ahead >= OFFSETS + delay)
        heard_at = np.minimum(wanted[:, columns] + delay, len(values) - 1)
        rows[:, columns] = values[np.maximum(heard_at, 0), head]
    rows[wanted < 0] = np.eye(len(PHONEMES), dtype=np.float32)[PHONEMES.index(SILENCE)]
    return window_means(rows)


def fit_soft_expectation(
    utterances: Sequence[Utterance],
    coefficients: Sequence[Array],
    copies: HeardCopies,
    *,
    seed: int = 0,
) -> SoftExpectation | None:
    """Fit the map from posteriors to faces; None for too few frames.

    coefficients: (n_frames, n_components) of each sentence. The same sentences, copies and seed
    give the same map.
    """
    table = looks()
    pairs = list(zip(utterances, coefficients, strict=True))
    found = [
        _rows(utterance, motion, copies, table)
        for utterance, motion in pairs
        if all(utterance.name in voice for voice in copies.voices)
    ]
    if sum(len(faces) for _, faces in found) < _FEWEST:
        return None
    inputs = np.concatenate([each for each, _ in found])
    faces = np.concatenate([each for _, each in found]).astype(np.float32)
    rng = np.random.default_rng(seed)
    with threadpool_limits(limits=1):  # several threads add up in changing order
        soft = _fitted(inputs, faces, table, rng)
        return _deviating(soft, pairs, copies)


def _rows(
    utterance: Utterance, motion: Array, copies: HeardCopies, table: Array32
) -> tuple[Array32, Array]:
    """Return a sentence's inputs (n, n_windows k) and faces (n, n_components) in all its voices."""
    spoken = np.flatnonzero(speech_frames(utterance))
    if not len(spoken):
        return np.empty((0, len(WINDOWS) * table.shape[1]), np.float32), motion[:0]
    margin = round(NEAR_SPEECH_S * utterance.frame_rate_hz)
    near = np.arange(max(0, spoken[0] - margin), min(len(motion), spoken[-1] + margin + 1))
    seen = [(copies.voices[voice], ahead, ahead == _FULL_AHEAD) for voice, ahead in _SEEN]
    seen += [(voice, _FULL_AHEAD, False) for voice in copies.by_others]
    inputs, faces = [], []
    for voice, ahead, is_whole in seen:
        chosen = near if is_whole else near[::2]
        frames = np.rint(chosen * (FRAMES_PER_S / utterance.frame_rate_hz))
        values = voice[utterance.name].astype(np.float32)
        means = believed_means(values, copies.delays, frames, ahead)
        inputs.append((means @ table).reshape(len(frames), -1))
        faces.append(motion[chosen])
    return np.concatenate(inputs), np.concatenate(faces)


def _fitted(
    inputs: Array32, faces: Array32, table: Array32, rng: np.random.Generator
) -> SoftExpectation:
    """Fit a ridge over cosines and inputs, and a network of rectifiers; return their mean."""
    d, n_components = inputs.shape[1], faces.shape[1]
    # In the file's precision, so that the ridge is fitted to what will be computed.
    frequencies = (rng.standard_normal((d, _N_COSINES)) / _WIDTH).astype(np.float16)
    phases = rng.uniform(0.0, 2.0 * np.pi, _N_COSINES).astype(np.float16)
    wide, shifts = frequencies.astype(np.float32), phases.astype(np.float32)
    scale = np.float32(_COSINE_SCALE * np.sqrt(2.0 / _N_COSINES))
    mean = faces.mean(axis=0)
    size = _N_COSINES + d + 1
    squares, products = np.zeros((size, size)), np.zeros((size, n_components))
    for first in range(0, len(inputs), 20_000):
        part = inputs[first : first + 20_000]
        cosines = scale * np.cos(part @ wide + shifts)
        ones = np.ones((len(part), 1), np.float32)
        design = np.concatenate([cosines, part, ones], axis=1)
        squares += design.T @ design
        products += design.T @ (faces[first : first + 20_000] - mean)
    penalty = np.full(size, _RIDGE)
    penalty[-1] = 1e-6
    ridge = np.linalg.solve(squares + np.diag(penalty), products)
    ridge[:_N_COSINES] *= scale
    ridge[-1] += mean

    centre, spread = inputs.mean(axis=0), inputs.std(axis=0) + np.float32(_SMALLEST_SPREAD)
    inputs -= centre
    inputs /= spread
    unit = np.float32(faces.std())
    layers = initial_layers((d, *_HIDDEN, n_components), rng)
    fit(layers, inputs, faces / unit, _SCHEDULE, rng)
    first_weights = layers[0] / spread[:, None]
    first_layer = np.concatenate([first_weights, (layers[1] - centre @ first_weights)[None]])
    second_layer = np.concatenate([layers[2], layers[3][None]])
    output = np.concatenate([ridge[:-1], unit * layers[4], ridge[-1:] + unit * layers[5]]) / 2.0
    return SoftExpectation(
        table, wide, shifts, first_layer, second_layer, output.astype(np.float32)
    )


def _deviating(
    soft: SoftExpectation, pairs: Sequence[tuple[Utterance, Array]], copies: HeardCopies
) -> SoftExpectation:
    """Return the map, amplified so that components deviate nearly as much as recorded ones."""
    expected, recorded = [], []
    for utterance, motion in pairs[::4]:
        spoken = np.flatnonzero(speech_frames(utterance))
        if not len(spoken) or utterance.name not in copies.voices[0]:
            continue
        frames = np.rint(spoken * (FRAMES_PER_S / utterance.frame_rate_hz))
        values = copies.voices[0][utterance.name].astype(np.float32)
        means = believed_means(values, copies.delays, frames, _FULL_AHEAD)
        expected.append(soft.faces(means))
        recorded.append(motion[spoken])
    gain, mean = gain_and_mean(expected, recorded, _DEVIATION)
    output = soft.output * gain
    output[-1] += (1.0 - gain) * mean
    return SoftExpectation(
        soft.looks, soft.frequencies, soft.phases, soft.first, soft.second,
        output.astype(np.float32),
    )  # fmt: skip
