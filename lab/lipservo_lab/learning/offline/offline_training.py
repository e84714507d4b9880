"""Train an offline model, for lines whose whole sound is known before the mouth moves.

Three parts: a state model (`state_training`); networks that predict the mean motion of a line from
its phonemes and its sound; and the voice's mean cepstrum with its spread, by which lines of other
voices are recognised.
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

#: Greatest distance at which a line counts as spoken by the voice. Of lines of the talker of
#: grid_s1 that were not learned from, 95 % are nearer than 1.5, and nearer than 2.5 where training
#: had none of their words; of 72 lines of LibriSpeech none is nearer than 3.6.
LIMIT = 3.0
#: Added to the diagonal of the covariance, as a share of the mean variance: keeps its inverse
#: finite where there are few lines.
_RIDGE = 1e-3


def fit_voice_likeness(mean_cepstra: Sequence[Array]) -> VoiceLikeness:
    """Fit a voice from the mean cepstrum of each of its lines.

    Parameters
    ----------
    mean_cepstra : Sequence[Array]
        (m,) each.

    Returns
    -------
    VoiceLikeness
        Mean (m,) and precision (m, m), of the identity as covariance if there is only one line.
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
#: Weight decay of each network. Less decay serves known words, more serves new ones. Two are
#: trained at once, so four take as long as three.
_DECAYS = (0.004, 0.012, 0.03, 0.012)
_AT_ONCE = 2
#: Weight of a millimetre of lip gap in the squared error, against a unit of a face coefficient.
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
    """Train networks that predict the mean face from a line's phonemes and sound.

    The networks also learn to predict the lip gap, as what they learn for the gap improves the
    face; the gap's output is then removed.

    Parameters
    ----------
    utterances : Sequence[Utterance]
        Sentences with phone labels.
    coefficients : Sequence[Array]
        Face coefficients (n_frames, n_components) of each.
    lip_gaps_mm : Sequence[Array]
        (n_frames,) of each.
    cepstra : Sequence[Array]
        Normalised cepstra (m, 13) of each, 100 a second.
    seed : int
        Draws initial weights and batches.
    progress : Progress
        Called with a line about what is being trained.

    Returns
    -------
    SoundExpectation
        Amplified by `with_sound_deviation`.
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

    def train_network(number: int) -> Layers:
        rng = np.random.default_rng([seed, number])
        layers = initial_layers((inputs.shape[1], *_HIDDEN, targets.shape[1]), rng)
        return fit(layers, inputs, targets, Schedule(_EPOCHS, _DECAYS[number]), rng)

    progress(f"expectation of sound, {len(_DECAYS)} networks")
    with threadpool_limits(limits=1), ThreadPoolExecutor(_AT_ONCE) as threads:
        networks = list(threads.map(train_network, range(len(_DECAYS))))
    # The same layer of all networks in one array. Then: the gap's output goes; biases get shape (m,
    # 1, n_out); outputs are scaled back.
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
    """Return the expectation, amplified so that its motion deviates nearly as much as the recorded.

    As `with_deviation` does it for the live expectation.

    Parameters
    ----------
    expectation : SoundExpectation
        Predicts faces from phonemes and sound, as learned.
    utterances : Sequence[Utterance]
        Sentences with phone labels.
    coefficients : Sequence[Array]
        Recorded face coefficients (n_frames, n_components) of each.
    cepstra : Sequence[Array]
        Normalised cepstra (m, 13) of each, 100 a second.

    Returns
    -------
    SoundExpectation
        With larger outputs where it deviates too little; unchanged if no sentence has speech.
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
    layers = (*expectation.layers[:-2], *(layer.astype(np.float32) for layer in last))
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

    The same input gives the same model. recipe: sizes and seed; None: the usual ones. progress:
    called with a line about each step. listening: wraps the sentences while their sound is read,
    for progress.

    The corpus may have more points than the face (dense scans): states are found in all of them,
    and only their means at the face's points are kept.

    Raises BuildingError for a corpus without labels, with too few frames for the number of states,
    or without one of the face's points; SoundError for a sound that cannot be read.
    """
    recipe = recipe or Recipe()
    utterances = corpus.labelled().utterances
    if not utterances:
        raise BuildingError(f"corpus {corpus.name}: no sentence has a tier `phones` in labels/")
    rows = _rows_of_face(corpus, face)
    sounds, mean_cepstra = [], []
    for utterance in listening(utterances):
        samples = read_speech(utterance.sound_path)
        sounds.append(cepstra(samples))
        mean_cepstra.append(mean_cepstrum(samples))
    frame_cepstra = [
        at_times(sound, np.arange(len(u.markers_mm)) / u.frame_rate_hz)
        for u, sound in zip(utterances, sounds, strict=True)
    ]
    states = build_states(utterances, frame_cepstra, recipe, progress)
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
        voice=fit_voice_likeness(mean_cepstra),
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
    """Return the rows of the corpus's points that are the face's points, in its order, (n_points,).

    Points are compared by landmark. Raises BuildingError if the corpus lacks one.
    """
    row_of = {landmark: row for row, landmark in enumerate(corpus.layout.landmarks)}
    missing = [number for number in face.layout.landmarks if number not in row_of]
    if missing:
        raise BuildingError(
            f"corpus {corpus.name}: lacks {len(missing)} of the {face.layout.n_points} points of "
            f"the face model, landmark {missing[0]} for one; give the model of this corpus"
        )
    return np.array([row_of[number] for number in face.layout.landmarks])


def _at_points(states: StateModel, rows: Indices) -> StateModel:
    """Return the states with only the points in `rows`.

    The rows of their basis are then not orthonormal; it only serves for points = mean + motion
    times basis.
    """
    columns = (3 * rows[:, None] + np.arange(3)).ravel()
    return replace(states, mean_mm=states.mean_mm[columns], basis=states.basis[:, columns])
