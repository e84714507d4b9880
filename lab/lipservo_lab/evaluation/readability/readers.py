"""Readers of words: what they see of a face, and how they tell words apart."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from sklearn.discriminant_analysis import LinearDiscriminantAnalysis
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from sklearn.svm import SVC

from lipservo_lab.corpus.utterance import CorpusError, Utterance
from lipservo_lab.evaluation.motion.lip_shape import lip_shapes_mm
from lipservo_lab.evaluation.readability.spoken_words import spoken_words, word_motion
from lipsync.arrays import Array
from lipsync.face.model import FaceModel

#: (n_frames, k) of every sentence, by its name.
Motions = Mapping[str, Array]


class Classifier(Protocol):
    """As scikit-learn has it."""

    def fit(self, x: Array, y: Sequence[str]) -> object:
        """Learn words y (n,) from features x (n, d)."""

    def predict(self, x: Array) -> NDArray[np.str_]:
        """(n, d) -> (n,)."""


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
    """Gap, width and protrusion in mm, less those of the mouth at rest."""
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
    """Learn the words of some slots from recorded sentences, `recorded` seen as the kind sees.

    Raises CorpusError for a slot in which there is nothing to tell apart, or too little to learn.
    """
    classifiers: dict[int, Classifier] = {}
    mean_words: dict[int, Array] = {}
    for slot in slots:
        words = words_of_slot(sentences, recorded, slot)
        texts = [spoken_words(u)[slot].text for u in sentences]
        if not 1 < len(set(texts)) < len(texts):
            raise CorpusError(
                f"word {slot + 1} of a sentence: {len(set(texts))} different among the "
                f"{len(texts)} recorded that a reader learns from; it needs two, and more recorded"
            )
        classifiers[slot] = kind.classifier()
        classifiers[slot].fit(words, texts)
        mean_words[slot] = words.mean(axis=0)
    return Reader(classifiers, mean_words)


def words_of_slot(sentences: Sequence[Utterance], motions: Motions, slot: int) -> Array:
    """(n_sentences, d): the motion of the word that each has in the slot."""
    return np.array(
        [word_motion(motions[u.name], u.frame_rate_hz, spoken_words(u)[slot]) for u in sentences]
    )
