"""Readers of words: classifiers that read words off the motion of a face, as a lip-reader does.

A sentence has slots, one a word. A reader has a classifier for each slot, and sees a word's motion
resampled to a fixed number of points. Recorded and synthesised motion is read by one protocol.

Known words: a reader fitted on the recorded words of all sentences outside the test reads the test.
New words: a face model was trained without the sentences that contain any of a set of words. The
reader must know these words, so it is fitted on recorded words of such sentences too, but by folds:
the sentences with words of the set are dealt into `N_FOLDS`, in turn in the order of their names,
and those of one fold are read by a reader fitted on all sentences outside that fold. So no sentence
is read by a reader that was fitted on its recording.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from lipservo_lab.corpus.utterance import CorpusError, Utterance, Word
from lipservo_lab.evaluation.motion.measures import lip_shapes_mm
from lipsync.arrays import Array
from lipsync.face.model import FaceModel

#: Seconds before and after a word that a reader sees too.
MARGIN_S = 0.08
#: Number of points that a word's motion is resampled to, so that its duration is not seen.
N_POINTS = 12
#: Labels of a short pause and of silence in GRID's own label files.
_PAUSES = ("sp", "sil")


def spoken_words(utterance: Utterance) -> tuple[Word, ...]:
    """Return the words of a sentence without pauses; the word at index n is in slot n."""
    return tuple(word for word in utterance.words if word.text not in _PAUSES)


def slotted(utterances: Sequence[Utterance]) -> list[Utterance]:
    """Return the labelled sentences that have the most frequent number of words, so equal slots.

    Raises CorpusError if no sentence has both phones and words.
    """
    labelled = [u for u in utterances if u.phones and spoken_words(u)]
    if not labelled:
        raise CorpusError("no sentence has both tiers `phones` and `words` in labels/")
    n_slots = Counter(len(spoken_words(u)) for u in labelled).most_common(1)[0][0]
    return [u for u in labelled if len(spoken_words(u)) == n_slots]


def word_motion(values: Array, frame_rate_hz: float, word: Word) -> Array:
    """Return the motion of a word and a margin around it, resampled linearly to N_POINTS.

    Parameters
    ----------
    values : Array
        (n_frames, k) of the word's sentence.
    frame_rate_hz : float
        Of `values`.
    word : Word
        The word, with its times.

    Returns
    -------
    Array
        (N_POINTS * k,).
    """
    frames_s = np.arange(len(values)) / frame_rate_hz
    points_s = np.linspace(word.start_s - MARGIN_S, word.end_s + MARGIN_S, N_POINTS)
    columns = [np.interp(points_s, frames_s, column) for column in values.T]
    return np.stack(columns, axis=1).ravel()


#: Values (n_frames, k) of every sentence, by the sentence's name.
Motions = Mapping[str, Array]


class Classifier(Protocol):
    """The part of scikit-learn's classifiers that readers use."""

    def fit(self, x: Array, y: Sequence[str]) -> object:
        """Learn words from features.

        Parameters
        ----------
        x : Array
            (n, d), features of n spoken words.
        y : Sequence[str]
            The n words.

        Returns
        -------
        object
            The classifier.
        """

    def predict(self, x: Array) -> NDArray[np.str_]:
        """Predict words.

        Parameters
        ----------
        x : Array
            (n, d), features of n spoken words.

        Returns
        -------
        NDArray[np.str_]
            (n,).
        """


@dataclass(frozen=True, slots=True)
class ReaderKind:
    """What a reader sees, and how it classifies.

    view: returns for a model and its markers (n_frames, n_points, 3) what is seen, (n_frames, k).
    classifier: makes a classifier that is not fitted yet.
    """

    name: str
    view: Callable[[FaceModel, NDArray[np.floating]], Array]
    classifier: Callable[[], Classifier]


def _components(model: FaceModel, markers_mm: NDArray[np.floating]) -> Array:
    """Return face coefficients, (n_frames, n_components)."""
    return model.coefficients(markers_mm)


def _discriminant() -> Classifier:
    """Return linear discriminants with the shrinkage of Ledoit and Wolf (2004)."""
    classifier: Classifier = LinearDiscriminantAnalysis(solver="lsqr", shrinkage="auto")
    return classifier


def _lips_from_rest(model: FaceModel, markers_mm: NDArray[np.floating]) -> Array:
    """Return gap, width and protrusion of the lips less those at rest, (n_frames, 3) mm."""
    rest_mm = model.markers_mm(model.rest[None])
    return lip_shapes_mm(model, markers_mm) - lip_shapes_mm(model, rest_mm)


def _support_vectors() -> Classifier:
    """Return support vectors with Gaussian kernels (scikit-learn's width) on standardised features.

    C = 3 was the best of 1 to 10 for reading recorded words of grid_s1, on sentences of no test.
    """
    classifier: Classifier = make_pipeline(StandardScaler(), SVC(C=3.0))
    return classifier


#: This reader sees the whole face, as the model's components.
COMPONENT_READER = ReaderKind("components", _components, _discriminant)
#: This one classifies in another way, and sees only what a robot's lips can show.
LIP_READER = ReaderKind("lips", _lips_from_rest, _support_vectors)
READERS = (COMPONENT_READER, LIP_READER)


@dataclass(frozen=True, slots=True)
class Reader:
    """A fitted classifier for each slot, and the slot's mean recorded word (d,)."""

    classifiers: Mapping[int, Classifier]
    mean_words: Mapping[int, Array]


def fit_reader(
    kind: ReaderKind, sentences: Sequence[Utterance], recorded: Motions, slots: Iterable[int]
) -> Reader:
    """Fit a reader to the words of each slot in recorded sentences.

    recorded: motion by sentence name, as this kind of reader sees it. Raises CorpusError for a slot
    with fewer than two different words, or without a word that occurs twice.
    """
    classifiers: dict[int, Classifier] = {}
    mean_words: dict[int, Array] = {}
    for slot in slots:
        words = words_of_slot(sentences, recorded, slot)
        texts = [spoken_words(u)[slot].text for u in sentences]
        if not 1 < len(set(texts)) < len(texts):
            raise CorpusError(
                f"word {slot + 1} of the {len(texts)} sentences that a lip-reader learns from: "
                f"{len(set(texts))} different; it needs 2, and some twice: record more sentences"
            )
        classifiers[slot] = kind.classifier()
        classifiers[slot].fit(words, texts)
        mean_words[slot] = words.mean(axis=0)
    return Reader(classifiers, mean_words)


def words_of_slot(sentences: Sequence[Utterance], motions: Motions, slot: int) -> Array:
    """Return the motion of the word that each sentence has in a slot.

    Parameters
    ----------
    sentences : Sequence[Utterance]
        Sentences with the words that they have in each slot.
    motions : Motions
        (n_frames, k) by sentence name.
    slot : int
        Index of the word.

    Returns
    -------
    Array
        (n_sentences, d), d = N_POINTS * k.
    """
    return np.array(
        [word_motion(motions[u.name], u.frame_rate_hz, spoken_words(u)[slot]) for u in sentences]
    )


N_FOLDS = 10


@dataclass(frozen=True, slots=True)
class Reading:
    """One word that was read.

    spoken, read: the word, and what the reader took it for. projection: product, summed over d
    features, of the deviations of the synthesised and of the recorded word from the slot's mean
    recorded word; recorded_square: the same product of the recorded word with itself.
    """

    sentence: str
    slot: int
    spoken: str
    read: str
    projection: float
    recorded_square: float


@dataclass(frozen=True, slots=True)
class Fold:
    """A reader with the sentences that it reads, none of which it was fitted on."""

    reader: Reader
    sentences: tuple[Utterance, ...]


def known_fold(
    kind: ReaderKind, sentences: Sequence[Utterance], test: frozenset[str], recorded: Motions
) -> tuple[Fold, ...]:
    """Return the one fold for known words: the test sentences, with a reader fitted on the others.

    sentences: from `slotted`; test: names. Raises CorpusError if the test holds none of the
    sentences, or all.
    """
    tested = tuple(u for u in sentences if u.name in test)
    others = [u for u in sentences if u.name not in test]
    if not tested or not others:
        raise CorpusError(f"{len(tested)} test sentences, {len(others)} to learn from; give more")
    slots = range(len(spoken_words(tested[0])))
    return (Fold(fit_reader(kind, others, recorded, slots), tested),)


def new_word_folds(
    kind: ReaderKind,
    sentences: Sequence[Utterance],
    words: frozenset[str],
    recorded: Motions,
    read: frozenset[str] | None = None,
) -> tuple[Fold, ...]:
    """Return folds for new words, with readers for the slots in which these are spoken.

    words: the new words. read: names of the sentences that are read; None: all that contain one of
    the words. Raises CorpusError for a word that no sentence to be read contains.
    """
    holding = [u for u in sentences_with(words, sentences) if read is None or u.name in read]
    slots = slots_of(words, sentences)
    missing = words - {w.text for u in holding for w in spoken_words(u)}
    if missing:
        raise CorpusError(f"no sentence holds {', '.join(map(repr, sorted(missing)))}")
    folds = []
    for first in range(min(N_FOLDS, len(holding))):
        of_fold = tuple(holding[first::N_FOLDS])
        names = {u.name for u in of_fold}
        others = [u for u in sentences if u.name not in names]
        folds.append(Fold(fit_reader(kind, others, recorded, slots), of_fold))
    return tuple(folds)


def sentences_with(words: frozenset[str], sentences: Iterable[Utterance]) -> list[Utterance]:
    """Return the sentences that contain any of the words, in the order of their names."""
    holding = [u for u in sentences if words & {w.text for w in spoken_words(u)}]
    return sorted(holding, key=lambda u: u.name)


def slots_of(words: frozenset[str], sentences: Iterable[Utterance]) -> list[int]:
    """Return the indices of the slots in which any of the words is spoken, ascending."""
    return sorted({s for u in sentences for s, w in enumerate(spoken_words(u)) if w.text in words})


def read_words(folds: Iterable[Fold], made: Motions, recorded: Motions) -> list[Reading]:
    """Read every sentence of every fold from its motion in `made`, and compare it with `recorded`.

    Motions are as the readers see them.
    """
    readings = []
    for fold in folds:
        for slot, classifier in fold.reader.classifiers.items():
            made_words = words_of_slot(fold.sentences, made, slot)
            made_away = made_words - fold.reader.mean_words[slot]
            recorded_away = words_of_slot(fold.sentences, recorded, slot)
            recorded_away -= fold.reader.mean_words[slot]
            rows = zip(
                fold.sentences,
                classifier.predict(made_words),
                _products(made_away, recorded_away),
                _products(recorded_away, recorded_away),
                strict=True,
            )
            readings += [
                Reading(u.name, slot, spoken_words(u)[slot].text, str(read), product, square)
                for u, read, product, square in rows
            ]
    return readings


def _products(one: Array, other: Array) -> list[float]:
    """Return the products of two arrays (n, d), summed over d."""
    return [float(x) for x in np.einsum("nd,nd->n", one, other)]
