"""Train the map from a recogniser's phoneme posteriors to faces (`SoftExpectation`).

The recordings are of few talkers. So the recogniser also gets every sentence as other voices in
other rooms would have spoken it (times stay), and the face is learned from its posteriors each
time; and from those of further recognisers, older or adapted, where some are given. A head with a
delay of d frames estimates a frame d frames later. So posteriors of frames are used only from heads
that have estimated them when the face must be decided: with a look-ahead of 100 ms for every frame,
with less for every other frame.
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

#: Factor on all frequencies of each copy, varied by a few percent; the first copy is the sentence
#: itself.
_VOICES: Final = (1.0, 0.86, 0.93, 1.09, 1.18)
_VOICE_SPREAD = 0.03
#: Copy, and how many frames of posteriors there are beyond a frame when its face is decided: 17
#: with a look-ahead of 100 ms, 7 with none, 12 with that of --low-latency.
_SEEN: Final = ((0, 17), (1, 17), (2, 17), (3, 17), (4, 17), (0, 7), (1, 7), (2, 12))
_FULL_AHEAD = 17
#: Silence after a sentence, until the head with the longest delay has estimated its end, s.
_TAIL_S = 0.25
#: All chosen on two inner splits of left-out words (docs/decisions/motion.md).
_N_COSINES, _WIDTH, _RIDGE, _COSINE_SCALE = 600, 9.0, 300.0, 10.0
_HIDDEN, _SCHEDULE = (192, 48), Schedule(n_epochs=3, decay=0.004)
_SMALLEST_SPREAD = 0.05
#: Share of the recorded deviation to reach; more than `SHARE` of the expectation by phonemes, since
#: half of a mean is a mean again.
_DEVIATION = 0.95
#: With fewer rows nothing is learned.
_FEWEST = 2000


@dataclass(frozen=True, slots=True)
class HeardCopies:
    """Posteriors (n_frames, n_heads, n_phonemes) by sentence name, a mapping for each of `_VOICES`.

    delays: of the heads, in frames. by_others: the same from further recognisers, which take turns
    from voice to voice; empty where there are none.
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

    Sentences whose sound cannot be read are left out. progress: wraps the sentences, with a line
    about the work. others: weights of further recognisers; each voice is also given to one of them.
    Raises UserError if their delays differ from those of `weights`.
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
            posteriors_of: dict[str, Array32] = {}
            posteriors_by_other: dict[str, Array32] = {}
            for utterance in progress(f"listening to voice {number + 1}", utterances):
                try:
                    samples = read_speech(utterance.sound_path)
                except SoundError:
                    continue
                samples = np.concatenate((samples, np.zeros(_n_tail_samples(), np.float32)))
                if number:
                    samples = _as_other_voice(rng, samples, factor)
                posteriors_of[utterance.name] = _half_posteriors(weights, samples)
                if others:
                    other = others[number % len(others)]
                    posteriors_by_other[utterance.name] = _half_posteriors(other, samples)
            voices.append(posteriors_of)
            by_others += [posteriors_by_other] if others else []
    return HeardCopies(weights.delays, tuple(voices), tuple(by_others))


def _half_posteriors(weights: NetworkWeights, samples: Array32) -> Array32:
    """Return posteriors (n_frames, n_heads, n_phonemes) in half precision.

    All sentences of a voice, 44 minutes, take 60 MB in place of 120.
    """
    return PosteriorStream(weights).push(samples).astype(np.float16)


def _delays_ms(weights: NetworkWeights) -> str:
    return ", ".join(f"{1000 * delay / FRAMES_PER_S:.0f}" for delay in weights.delays) + " ms"


def _n_tail_samples() -> int:
    return round(_TAIL_S * FRAMES_PER_S) * HOP


def _as_other_voice(rng: np.random.Generator, samples: Array32, factor: float) -> Array32:
    """Return samples as of another voice in another room at another level, of the same length.

    factor: on all frequencies, varied by 3 %. Room, noise and telephone line are added by chance.
    """
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
    """Return features of each phoneme that phonemes without recordings share with recorded ones.

    Returns
    -------
    Array32
        (n_phonemes, k): articulation, and the viseme class, one-hot.
    """
    classes = np.eye(len(VISEME_CLASSES))[[VISEME_OF[phoneme] for phoneme in PHONEMES]]
    return np.concatenate([articulatory_features(), classes], axis=1).astype(np.float32)


def believed_means(values: Array32, delays: Sequence[int], frames: Array, ahead: int) -> Array32:
    """Return the mean posteriors in windows around frames, as known live `ahead` frames later.

    For each frame the posterior comes from the head with the longest delay that has estimated it by
    then. Before the recording there was silence; frames that no head has estimated yet count 0.

    Parameters
    ----------
    values : Array32
        (n_frames, n_heads, n_phonemes) posteriors of a recording.
    delays : Sequence[int]
        Of the heads, in frames, rising.
    frames : Array
        (n,) frame numbers, whole, at 100 a second.
    ahead : int
        Frames that the recogniser has processed beyond each of `frames`.

    Returns
    -------
    Array32
        (n, n_windows, n_phonemes).
    """
    around = frames.astype(np.int64)[:, None] + OFFSETS
    posteriors = np.zeros((*around.shape, values.shape[2]), np.float32)
    for head, delay in enumerate(delays):
        known_offsets = np.flatnonzero(ahead >= OFFSETS + delay)
        estimated_at = np.minimum(around[:, known_offsets] + delay, len(values) - 1)
        # Heads with longer delays come later and replace the others.
        posteriors[:, known_offsets] = values[np.maximum(estimated_at, 0), head]
    posteriors[around < 0] = np.eye(len(PHONEMES), dtype=np.float32)[PHONEMES.index(SILENCE)]
    return window_means(posteriors)


def fit_soft_expectation(
    utterances: Sequence[Utterance],
    coefficients: Sequence[Array],
    copies: HeardCopies,
    *,
    seed: int = 0,
) -> SoftExpectation | None:
    """Fit the map from posteriors to faces; return None if there are fewer than 2,000 rows.

    coefficients: recorded faces (n_frames, n_components) of each sentence. Sentences that are
    missing in one of the copies are left out. The same sentences, copies and seed give the same
    map.
    """
    table = looks()
    pairs = list(zip(utterances, coefficients, strict=True))
    inputs_and_faces = [
        _inputs_and_faces(utterance, motion, copies, table)
        for utterance, motion in pairs
        if all(utterance.name in voice for voice in copies.voices)
    ]
    if sum(len(faces) for _, faces in inputs_and_faces) < _FEWEST:
        return None
    inputs = np.concatenate([each for each, _ in inputs_and_faces])
    faces = np.concatenate([each for _, each in inputs_and_faces]).astype(np.float32)
    rng = np.random.default_rng(seed)
    with threadpool_limits(limits=1):  # several threads add up in changing order
        soft = _fit_map(inputs, faces, table, rng)
        return _with_deviation(soft, pairs, copies)


def _inputs_and_faces(
    utterance: Utterance, motion: Array, copies: HeardCopies, table: Array32
) -> tuple[Array32, Array]:
    """Return training pairs of a sentence: inputs (n, n_windows * k), motion (n, n_components).

    motion: as recorded (n_frames, n_components). copies: what recognisers make of the sentence in
    several voices; each gives pairs, most of them of every second frame. table: (n_phonemes, k),
    each phoneme's features (`looks`). Frames lie between 0.3 s before the first spoken frame and
    0.3 s after the last; without speech there are none.
    """
    spoken = np.flatnonzero(speech_frames(utterance))
    if not len(spoken):
        return np.empty((0, len(WINDOWS) * table.shape[1]), np.float32), motion[:0]
    margin = round(NEAR_SPEECH_S * utterance.frame_rate_hz)
    near = np.arange(max(0, spoken[0] - margin), min(len(motion), spoken[-1] + margin + 1))
    copies_seen = [(copies.voices[voice], ahead, ahead == _FULL_AHEAD) for voice, ahead in _SEEN]
    copies_seen += [(voice, _FULL_AHEAD, False) for voice in copies.by_others]
    inputs, faces = [], []
    for voice, ahead, every_frame in copies_seen:
        chosen = near if every_frame else near[::2]
        frames = np.rint(chosen * (FRAMES_PER_S / utterance.frame_rate_hz))
        values = voice[utterance.name].astype(np.float32)
        means = believed_means(values, copies.delays, frames, ahead)
        inputs.append((means @ table).reshape(len(frames), -1))
        faces.append(motion[chosen])
    return np.concatenate(inputs), np.concatenate(faces)


def _fit_map(
    inputs: Array32, faces: Array32, table: Array32, rng: np.random.Generator
) -> SoftExpectation:
    """Fit a ridge regression over cosines and inputs, and a network of rectifiers; average them.

    inputs (n, d) are changed in place; faces (n, n_components); table: of `looks`.
    """
    d, n_components = inputs.shape[1], faces.shape[1]
    # In the file's precision, so that the ridge is fitted to what will be computed.
    frequencies = (rng.standard_normal((d, _N_COSINES)) / _WIDTH).astype(np.float16)
    phases = rng.uniform(0.0, 2.0 * np.pi, _N_COSINES).astype(np.float16)
    wide, shifts = frequencies.astype(np.float32), phases.astype(np.float32)
    scale = np.float32(_COSINE_SCALE * np.sqrt(2.0 / _N_COSINES))
    mean = faces.mean(axis=0)
    size = _N_COSINES + d + 1
    gram, products = np.zeros((size, size)), np.zeros((size, n_components))
    # Normal equations, summed over blocks of rows to save memory.
    for first in range(0, len(inputs), 20_000):
        block = inputs[first : first + 20_000]
        cosines = scale * np.cos(block @ wide + shifts)
        ones = np.ones((len(block), 1), np.float32)
        design = np.concatenate([cosines, block, ones], axis=1)
        gram += design.T @ design
        products += design.T @ (faces[first : first + 20_000] - mean)
    penalty = np.full(size, _RIDGE)
    # The intercept is not penalised.
    penalty[-1] = 1e-6
    ridge = np.linalg.solve(gram + np.diag(penalty), products)
    ridge[:_N_COSINES] *= scale
    ridge[-1] += mean

    # The network is trained on scaled inputs; the scaling is then folded into its first layer.
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


def _with_deviation(
    soft: SoftExpectation, pairs: Sequence[tuple[Utterance, Array]], copies: HeardCopies
) -> SoftExpectation:
    """Return the map, amplified so that components deviate nearly as much as recorded ones.

    Compared are frames with speech in every fourth sentence, in the sentences' own voice.
    """
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
