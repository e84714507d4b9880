"""Learning what to expect of a line from its phonemes and its sound."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from lipservo_lab.corpus.speech_frames import speech_frames
from lipservo_lab.corpus.utterance import Utterance
from lipservo_lab.learning.expectation.articulation import articulatory_features
from lipservo_lab.learning.expectation.deviation import gain_and_mean
from lipservo_lab.learning.expectation.networks import Layers, Schedule, fit, initial_layers
from lipsync.arrays import Array
from lipsync.offline.sound_expectation import SoundExpectation, line_inputs

Progress = Callable[[str], None]

#: Chosen on inner splits (docs/decisions/0029).
_HIDDEN = (256, 64)
_EPOCHS = 10
#: A network each. Less decay serves known words, more serves new ones. Two learn at once, so four
#: take as long as three.
_DECAYS = (0.004, 0.012, 0.03, 0.012)
_AT_ONCE = 2
#: How much a millimetre of lip gap counts beside one of a component.
_GAP_WEIGHT = 3.0
#: A feature that hardly varies in training must not run away when it does later.
_SMALLEST_SPREAD = 0.05


def fit_sound_expectation(
    utterances: Sequence[Utterance],
    coefficients: Sequence[Array],
    lip_gaps_mm: Sequence[Array],
    cepstra: Sequence[Array],
    *,
    seed: int,
    progress: Progress = lambda _: None,
) -> SoundExpectation:
    """From labelled sentences, their motion (n_frames, n_components), and cepstra, 100 a second.

    lip_gaps_mm: (n_frames,) of each. The networks learn to tell the gap beside the face, and what
    they learn for it serves the face; it is not kept.
    """
    articulation = articulatory_features().astype(np.float32)
    inputs = np.concatenate(
        [
            line_inputs(u.phones, sound, np.arange(len(motion)) / u.frame_rate_hz, articulation)
            for u, motion, sound in zip(utterances, coefficients, cepstra, strict=True)
        ]
    )
    faces = np.concatenate(coefficients)
    gaps_mm = np.concatenate(lip_gaps_mm)
    mean, spread = inputs.mean(axis=0), inputs.std(axis=0) + np.float32(_SMALLEST_SPREAD)
    inputs = (inputs - mean) / spread
    unit = max(float(faces.std()), 1e-9)
    told = _GAP_WEIGHT * (gaps_mm - gaps_mm.mean())
    targets = (np.concatenate([faces, told[:, None]], axis=1) / unit).astype(np.float32)

    def learn(number: int) -> Layers:
        rng = np.random.default_rng([seed, number])
        layers = initial_layers((inputs.shape[1], *_HIDDEN, targets.shape[1]), rng)
        return fit(layers, inputs, targets, Schedule(_EPOCHS, _DECAYS[number]), rng)

    progress(f"expectation of sound, {len(_DECAYS)} networks")
    with threadpool_limits(limits=1), ThreadPoolExecutor(_AT_ONCE) as threads:
        networks = list(threads.map(learn, range(len(_DECAYS))))
    layers = [np.stack(each) for each in zip(*networks, strict=True)]
    layers[-2:] = [each[..., :-1] for each in layers[-2:]]
    layers[1::2] = [bias[:, None] for bias in layers[1::2]]
    layers[-2:] = [each * np.float32(unit) for each in layers[-2:]]
    learned = SoundExpectation(articulation, mean, spread, tuple(layers))
    return with_sound_deviation(learned, utterances, coefficients, cepstra)


def with_sound_deviation(
    expectation: SoundExpectation,
    utterances: Sequence[Utterance],
    coefficients: Sequence[Array],
    cepstra: Sequence[Array],
) -> SoundExpectation:
    """The same whose components deviate as far as those of the live one (`with_deviation`)."""
    expected, recorded = [], []
    for utterance, motion, sound in zip(utterances, coefficients, cepstra, strict=True):
        spoken = speech_frames(utterance)
        if spoken.any():
            times_s = np.flatnonzero(spoken) / utterance.frame_rate_hz
            expected.append(expectation.faces(utterance.phones, sound, times_s))
            recorded.append(motion[spoken])
    if not expected:
        return expectation
    gain, mean = gain_and_mean(expected, recorded)
    weights, bias = expectation.layers[-2:]
    last = (weights * gain, bias * gain + (1.0 - gain) * mean)
    layers = (*expectation.layers[:-2], *(each.astype(np.float32) for each in last))
    return replace(expectation, layers=layers)
