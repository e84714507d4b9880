"""A corpus becomes an offline model.

What a voice sounds like on the whole, and how far off lines of the same voice may be.

Learning what to expect of a line from its phonemes and its sound.
"""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from lipservo_lab.corpus.utterance import Corpus, Utterance, speech_frames
from lipservo_lab.learning.expectation.deviation import gain_and_mean
from lipservo_lab.learning.expectation.expectation_training import (
    Layers,
    Schedule,
    articulatory_features,
    fit,
    initial_layers,
)
from lipservo_lab.learning.offline.state_training import BuildingError, Recipe, build_states
from lipsync.arrays import Array, Indices
from lipsync.audio.file import read_speech
from lipsync.face.model import FaceModel
from lipsync.offline.offline_model import (
    OfflineModel,
    SoundExpectation,
    StateModel,
    VoiceLikeness,
    at_times,
    cepstra,
    line_inputs,
    mean_cepstrum,
)

#: Of lines of the talker of grid_s1 that were not learned from 95 % are nearer than 1.5, and 2.5
#: where words of theirs were never heard; of 72 lines of LibriSpeech none is nearer than 3.6.
LIMIT = 3.0
#: Keeps the inverse finite where there are few lines, as a share of the mean variance.
_RIDGE = 1e-3


def fit_voice_likeness(mean_cepstra: Sequence[Array]) -> VoiceLikeness:
    """Fit a voice from the mean cepstrum of each line.

    Parameters
    ----------
    mean_cepstra : Sequence[Array]
        (m,) each.

    Returns
    -------
    VoiceLikeness
        Mean (m,) and precision (m, m).
    """
    lines = np.array(mean_cepstra)
    covariance = np.atleast_2d(np.cov(lines, rowvar=False)) if len(lines) > 1 else np.eye(12)
    ridge = _RIDGE * max(float(np.trace(covariance)) / len(covariance), 1e-9)
    precision = np.linalg.inv(covariance + ridge * np.eye(len(covariance)))
    return VoiceLikeness(lines.mean(axis=0), np.asarray(precision, np.float64), LIMIT)


Progress = Callable[[str], None]

#: Chosen on inner splits (docs/decisions/scripted-lines.md).
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
    """Learn from labelled sentences, their motion, and cepstra, 100 a second.

    The networks learn to tell the gap beside the face, and what they learn for it serves the face;
    it is not kept.

    Parameters
    ----------
    utterances : Sequence[Utterance]
        Labelled.
    coefficients : Sequence[Array]
        (n_frames, n_components) of each.
    lip_gaps_mm : Sequence[Array]
        (n_frames,) of each.
    cepstra : Sequence[Array]
        (m, 13) of each.
    seed : int
        Of weights and batches.
    progress : Progress
        Called with the progress.

    Returns
    -------
    SoundExpectation
        The expectation.
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
    weighted = _GAP_WEIGHT * (gaps_mm - gaps_mm.mean())
    targets = (np.concatenate([faces, weighted[:, None]], axis=1) / unit).astype(np.float32)

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
    """Return the expectation with components that deviate as the live one's (`with_deviation`).

    Parameters
    ----------
    expectation : SoundExpectation
        Learned.
    utterances : Sequence[Utterance]
        Labelled.
    coefficients : Sequence[Array]
        (n_frames, n_components) of each.
    cepstra : Sequence[Array]
        (m, 13) of each.

    Returns
    -------
    SoundExpectation
        Amplified where it deviates less.
    """
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


Track = Callable[[Sequence[Utterance]], Iterable[Utterance]]


def train_offline(
    corpus: Corpus,
    face: FaceModel,
    recipe: Recipe | None = None,
    *,
    progress: Callable[[str], None] = lambda _: None,
    listening: Track = iter,
) -> OfflineModel:
    """Learn an offline model for a face from every labelled sentence of a corpus.

    The same input gives the same model.

    The corpus may have more points than the face (dense scans): states are found in all of them,
    and what they say of the face's own points is kept, so that lines are projected on the face's
    components whatever the states were made of.

    listening: wraps the sentences while their sound is read, for progress. Raises BuildingError for
    a corpus without labels, too small for the number of states, or without a point of the face's;
    SoundError for a sound that cannot be read.
    """
    recipe = recipe or Recipe()
    utterances = corpus.labelled().utterances
    if not utterances:
        raise BuildingError(f"corpus {corpus.name}: no sentence has a tier `phones` in labels/")
    rows = _rows_of_face(corpus, face)
    sounds, voices = [], []
    for utterance in listening(utterances):
        samples = read_speech(utterance.sound_path)
        sounds.append(cepstra(samples))
        voices.append(mean_cepstrum(samples))
    at_frames = [
        at_times(sound, np.arange(len(u.markers_mm)) / u.frame_rate_hz)
        for u, sound in zip(utterances, sounds, strict=True)
    ]
    states = build_states(utterances, at_frames, recipe, progress)
    on_face = [u.markers_mm[:, rows] for u in utterances]
    sound = fit_sound_expectation(
        utterances,
        [face.coefficients(markers_mm) for markers_mm in on_face],
        [face.lip_gaps_mm(markers_mm) for markers_mm in on_face],
        sounds,
        seed=recipe.seed,
        progress=progress,
    )
    return OfflineModel(
        face_checksum=face.checksum,
        states=_at_points(states, rows),
        sound=sound,
        voice=fit_voice_likeness(voices),
        training_sentences=tuple(u.name for u in utterances),
        provenance={
            "corpus": corpus.name,
            "seed": recipe.seed,
            "frames": len(states.states),
            "states": states.n_states,
            "components": states.n_components,
            "points": corpus.layout.n_points,
            "units": len(states.units.phonemes),
            "mean_successors": round(float(states.follows.sum()) / states.n_states, 2),
        },
    )


def _rows_of_face(corpus: Corpus, face: FaceModel) -> Indices:
    """Return which points of the corpus are the face's, (n_points,), by their landmarks.

    Raises BuildingError where one is missing.
    """
    row_of = {landmark: row for row, landmark in enumerate(corpus.layout.landmarks)}
    missing = [n for n in face.layout.landmarks if n not in row_of]
    if missing:
        raise BuildingError(
            f"corpus {corpus.name}: lacks {len(missing)} of the {face.layout.n_points} points of "
            f"the face model, landmark {missing[0]} for one; give the model of this corpus"
        )
    return np.array([row_of[n] for n in face.layout.landmarks])


def _at_points(states: StateModel, rows: Indices) -> StateModel:
    """The states at some of the points; the components' rows are then not orthonormal.

    Nothing is made of them but points: mean + motion times basis.
    """
    columns = (3 * rows[:, None] + np.arange(3)).ravel()
    return replace(states, mean_mm=states.mean_mm[columns], basis=states.basis[:, columns])
