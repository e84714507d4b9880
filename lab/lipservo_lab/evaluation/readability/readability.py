"""The readability of one method's motion on one model, in one call."""

from collections.abc import Iterable, Sequence

import numpy as np

from lipservo_lab.corpus.utterance import Utterance
from lipservo_lab.evaluation.motion.methods import Method
from lipservo_lab.evaluation.motion.motion_scores import Listen, Progress, true_phonemes
from lipservo_lab.evaluation.readability.readers import COMPONENT_READER, Motions, ReaderKind
from lipservo_lab.evaluation.readability.reading_scores import (
    ReadingScore,
    known_score,
    new_word_score,
)
from lipservo_lab.evaluation.readability.readings import (
    known_fold,
    new_word_folds,
    read_words,
    sentences_with,
)
from lipservo_lab.evaluation.readability.spoken_words import MARGIN_S, slotted, spoken_words
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipsync.face.model import FaceModel


def known_readability(
    model: TrainedModel,
    utterances: Sequence[Utterance],
    test: frozenset[str],
    method: Method | None,
    *,
    lookahead_s: float = 0.1,
    listen: Listen = true_phonemes,
    kind: ReaderKind = COMPONENT_READER,
    progress: Progress = iter,
) -> ReadingScore:
    """How well the test's words are read off the method's motion; None: off the recorded one.

    utterances: test and what the reader is fitted on, in the model's points. The model must not
    have learned the test.
    """
    sentences = slotted(utterances)
    recorded = recorded_motions(model, sentences, kind)
    folds = known_fold(kind, sentences, test, recorded)
    made = recorded
    if method is not None:
        read = [u for u in sentences if u.name in test]
        faces = made_faces(model, progress(read), method, lookahead_s, listen)
        made = seen_motions(model, faces, kind)
    return known_score(read_words(folds, made, recorded))


def new_word_readability(
    model: TrainedModel,
    utterances: Sequence[Utterance],
    words: frozenset[str],
    method: Method | None,
    *,
    lookahead_s: float = 0.1,
    listen: Listen = true_phonemes,
    kind: ReaderKind = COMPONENT_READER,
    progress: Progress = iter,
) -> ReadingScore:
    """The same of words that the model has not learned, in all sentences that hold one of them."""
    sentences = slotted(utterances)
    recorded = recorded_motions(model, sentences, kind)
    folds = new_word_folds(kind, sentences, words, recorded)
    made = recorded
    if method is not None:
        read = sentences_with(words, sentences)
        faces = made_faces(model, progress(read), method, lookahead_s, listen)
        made = seen_motions(model, faces, kind)
    return new_word_score(read_words(folds, made, recorded), words)


def recorded_motions(model: FaceModel, sentences: Iterable[Utterance], kind: ReaderKind) -> Motions:
    """Recorded faces as a reader sees them, at the recording's frames."""
    return {u.name: kind.view(model, u.markers_mm) for u in sentences}


def seen_motions(model: FaceModel, faces: Motions, kind: ReaderKind) -> Motions:
    """Faces (n_frames, n_components) of sentences as a reader sees them."""
    return {name: kind.view(model, model.markers_mm(each)) for name, each in faces.items()}


def made_faces(
    model: TrainedModel,
    sentences: Iterable[Utterance],
    method: Method,
    lookahead_s: float,
    listen: Listen,
    rate_hz: float | None = None,
) -> Motions:
    """(n_frames, n_components) of each sentence; rate_hz: None for the recording's frames.

    What comes after the last word is not played: nobody reads it.
    """
    made = {}
    for utterance in sentences:
        rate = rate_hz or utterance.frame_rate_hz
        duration_s = len(utterance.markers_mm) / utterance.frame_rate_hz
        until_s = min(duration_s, seen_until_s(utterance))
        times_s = np.arange(0.0, until_s, 1.0 / rate)
        made[utterance.name] = method.faces(model, listen(utterance), times_s, lookahead_s)
    return made


def seen_until_s(utterance: Utterance) -> float:
    """When a reader has seen the last word, and the frame after it."""
    return spoken_words(utterance)[-1].end_s + MARGIN_S + 1.0 / utterance.frame_rate_hz
