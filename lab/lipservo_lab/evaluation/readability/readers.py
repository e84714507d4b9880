"""Readers of words: what they see of a face, and how they tell words apart.

The words of recorded sentences, slot by slot, and the motion of one word as a reader sees it.

What readers read off motion: recorded and made alike, by one protocol.

Known words: a reader fitted on the recorded words of all sentences outside the test reads the
test. New words: a model has learned no sentence that holds any of a set; the reader must know them,
so it is fitted on recorded words of such sentences too, but by folds: the sentences that hold words
of the set are dealt into `N_FOLDS`, by turns in the order of their names, and those of one fold are
read by a reader fitted on all sentences outside that fold. So no sentence is read by a reader that
has seen its recording.
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

#: A word is seen from so long before its beginning until so long after its end.
MARGIN_S = 0.08
#: And resampled to so many points, so that its duration is not seen.
N_POINTS = 12
#: Short pause and silence: how GRID's own labels write what is no word.
_PAUSES = ("sp", "sil")


def spoken_words(utterance: Utterance) -> tuple[Word, ...]:
    """Return the words of a sentence without its pauses; the n-th is in slot n."""
    return tuple(word for word in utterance.words if word.text not in _PAUSES)


def slotted(utterances: Sequence[Utterance]) -> list[Utterance]:
    """Return the labelled sentences with the most frequent number of words, thus equal slots.

    Raises CorpusError where no sentence has words.
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
        (n_frames, k) of a sentence.
    frame_rate_hz : float
        Of it.
    word : Word
        With its times.

    Returns
    -------
    Array
        (N_POINTS * k,).
    """
    frames_s = np.arange(len(values)) / frame_rate_hz
    points_s = np.linspace(word.start_s - MARGIN_S, word.end_s + MARGIN_S, N_POINTS)
    columns = [np.interp(points_s, frames_s, column) for column in values.T]
    return np.stack(columns, axis=1).ravel()


#: (n_frames, k) of every sentence, by its name.
Motions = Mapping[str, Array]


class Classifier(Protocol):
    """As scikit-learn has it."""

    def fit(self, x: Array, y: Sequence[str]) -> object:
        """Learn words from features.

        Parameters
        ----------
        x : Array
            (n, d).
        y : Sequence[str]
            n words.

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
            (n, d).

        Returns
        -------
        NDArray[np.str_]
            (n,).
        """


@dataclass(frozen=True, slots=True)
class ReaderKind:
    """view: a model and its markers (n_frames, n_points, 3) -> what is seen (n_frames, k)."""

    name: str
    view: Callable[[FaceModel, NDArray[np.floating]], Array]
    classifier: Callable[[], Classifier]


def _components(model: FaceModel, markers_mm: NDArray[np.floating]) -> Array:
    return model.coefficients(markers_mm)


def _discriminant() -> Classifier:
    """Linear discriminants with the shrinkage of Ledoit and Wolf (2004)."""
    classifier: Classifier = LinearDiscriminantAnalysis(solver="lsqr", shrinkage="auto")
    return classifier


def _lips_from_rest(model: FaceModel, markers_mm: NDArray[np.floating]) -> Array:
    """Return gap, width and protrusion, mm, less those of the mouth at rest."""
    rest_mm = model.markers_mm(model.rest[None])
    return lip_shapes_mm(model, markers_mm) - lip_shapes_mm(model, rest_mm)


def _support_vectors() -> Classifier:
    """Support vectors with Gaussian kernels (scikit-learn's width) on standardised features.

    C = 3 read recorded words of grid_s1 best among 1 to 10, on sentences of no test.
    """
    classifier: Classifier = make_pipeline(StandardScaler(), SVC(C=3.0))
    return classifier


#: Sees the whole face, in the model's components.
COMPONENT_READER = ReaderKind("components", _components, _discriminant)
#: Of another kind, and sees of the lips only what a robot can show.
LIP_READER = ReaderKind("lips", _lips_from_rest, _support_vectors)
READERS = (COMPONENT_READER, LIP_READER)


@dataclass(frozen=True, slots=True)
class Reader:
    """One classifier for each slot, and the mean word (d,) of each, as it was fitted."""

    classifiers: Mapping[int, Classifier]
    mean_words: Mapping[int, Array]


def fit_reader(
    kind: ReaderKind, sentences: Sequence[Utterance], recorded: Motions, slots: Iterable[int]
) -> Reader:
    """Train a reader to tell the words of each slot apart, from recorded sentences.

    recorded: motion by sentence, of the features that this kind of reader sees. Raises CorpusError
    for a slot with fewer than two words, or with no word that occurs twice.
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
        n_sentences.
    motions : Motions
        (n_frames, k) by name.
    slot : int
        Its number.

    Returns
    -------
    Array
        (n_sentences, d).
    """
    return np.array(
        [word_motion(motions[u.name], u.frame_rate_hz, spoken_words(u)[slot]) for u in sentences]
    )


N_FOLDS = 10


@dataclass(frozen=True, slots=True)
class Reading:
    """One word that was read.

    projection: of the made word's deviation from the slot's mean recorded word, on the recorded
    word's: their product over d features; recorded_square: the recorded one's with itself.
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
    """Return the one fold of known words.

    sentences: from `slotted`, the test among them. Raises CorpusError where the test holds none of
    them, or all.
    """
    read = tuple(u for u in sentences if u.name in test)
    fitted = [u for u in sentences if u.name not in test]
    if not read or not fitted:
        raise CorpusError(f"{len(read)} test sentences, {len(fitted)} to learn from; give more")
    slots = range(len(spoken_words(read[0])))
    return (Fold(fit_reader(kind, fitted, recorded, slots), read),)


def new_word_folds(
    kind: ReaderKind,
    sentences: Sequence[Utterance],
    words: frozenset[str],
    recorded: Motions,
    read: frozenset[str] | None = None,
) -> tuple[Fold, ...]:
    """Return folds for new words, with a reader for the slots in which they are spoken.

    read: names of the sentences that are read; None: all that hold one of the words. Raises
    CorpusError for a word that no such sentence holds.
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
        fitted = [u for u in sentences if u.name not in names]
        folds.append(Fold(fit_reader(kind, fitted, recorded, slots), of_fold))
    return tuple(folds)


def sentences_with(words: frozenset[str], sentences: Iterable[Utterance]) -> list[Utterance]:
    """Return the sentences that hold any of the words, by name."""
    holding = [u for u in sentences if words & {w.text for w in spoken_words(u)}]
    return sorted(holding, key=lambda u: u.name)


def slots_of(words: frozenset[str], sentences: Iterable[Utterance]) -> list[int]:
    """The slots in which any of the words is spoken."""
    return sorted({s for u in sentences for s, w in enumerate(spoken_words(u)) if w.text in words})


def read_words(folds: Iterable[Fold], made: Motions, recorded: Motions) -> list[Reading]:
    """Read every sentence of every fold from the motion `made`, and compare it with `recorded`."""
    readings = []
    for fold in folds:
        for slot, classifier in fold.reader.classifiers.items():
            seen = words_of_slot(fold.sentences, made, slot)
            away = seen - fold.reader.mean_words[slot]
            recorded_away = words_of_slot(fold.sentences, recorded, slot)
            recorded_away -= fold.reader.mean_words[slot]
            found = zip(
                fold.sentences,
                classifier.predict(seen),
                _products(away, recorded_away),
                _products(recorded_away, recorded_away),
                strict=True,
            )
            readings += [
                Reading(u.name, slot, spoken_words(u)[slot].text, str(read), product, square)
                for u, read, product, square in found
            ]
    return readings


def _products(one: Array, other: Array) -> list[float]:
    return [float(x) for x in np.einsum("nd,nd->n", one, other)]
