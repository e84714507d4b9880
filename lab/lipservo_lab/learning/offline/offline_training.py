"""A corpus becomes an offline model."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import numpy as np

from lipservo_lab.corpus.utterance import Corpus, Utterance
from lipservo_lab.learning.offline.sound_training import fit_sound_expectation
from lipservo_lab.learning.offline.state_training import BuildingError, Recipe, build_states
from lipservo_lab.learning.offline.voice_training import fit_voice_likeness
from lipsync.arrays import Indices
from lipsync.face.model import FaceModel
from lipsync.offline.cepstra import at_times, cepstra
from lipsync.offline.offline_model import OfflineModel
from lipsync.offline.state_model import StateModel
from lipsync.offline.voice_likeness import mean_cepstrum
from lipsync.recognition.speech_file import read_speech

Track = Callable[[Sequence[Utterance]], Iterable[Utterance]]


def train_offline(
    corpus: Corpus,
    face: FaceModel,
    recipe: Recipe | None = None,
    *,
    progress: Callable[[str], None] = lambda _: None,
    listening: Track = iter,
) -> OfflineModel:
    """An offline model for a face, of every labelled sentence; the same input gives the same.

    The corpus may have more points than the face, dense scans for one: the states are found in all
    of them, and what they say of the face's own points is kept, so that lines are projected on the
    face's components whatever the states were made of.

    listening: goes through the sentences while their sound is read. Raises BuildingError for a
    corpus without labels, too small for the states asked, or without a point of the face's;
    SoundError for a sound that cannot be read.
    """
    recipe = recipe or Recipe()
    utterances = corpus.labelled().utterances
    if not utterances:
        raise BuildingError(f"corpus {corpus.name}: no sentence has a phones tier")
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
    """Which points of the corpus are those of the face, (n_points,), by their landmarks."""
    row_of = {landmark: row for row, landmark in enumerate(corpus.layout.landmarks)}
    missing = [n for n in face.layout.landmarks if n not in row_of]
    if missing:
        raise BuildingError(
            f"corpus {corpus.name}: its points are not those of the face model: "
            f"{len(missing)} of {face.layout.n_points} are missing, landmark {missing[0]} first"
        )
    return np.array([row_of[n] for n in face.layout.landmarks])


def _at_points(states: StateModel, rows: Indices) -> StateModel:
    """The same states, told of some of the points; the components' rows are then not orthonormal.

    Nothing is made of them but points: mean + motion times basis.
    """
    columns = (3 * rows[:, None] + np.arange(3)).ravel()
    return replace(states, mean_mm=states.mean_mm[columns], basis=states.basis[:, columns])
