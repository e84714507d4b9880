"""What readers read off motion: recorded and made alike, by one protocol.

Known words: a reader fitted on the recorded words of all sentences outside the test reads the
test. New words: a model has learned no sentence that holds any of a set; the reader must know them,
so it is fitted on recorded words of such sentences too, but by folds: the sentences that hold words
of the set are dealt into `N_FOLDS`, by turns in the order of their names, and those of one fold are
read by a reader fitted on all sentences outside that fold. So no sentence is read by a reader that
has seen its recording.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from lipservo_lab.corpus.utterance import CorpusError, Utterance
from lipservo_lab.evaluation.readability.readers import (
    Motions,
    Reader,
    ReaderKind,
    fit_reader,
    words_of_slot,
)
from lipservo_lab.evaluation.readability.spoken_words import spoken_words
from lipsync.arrays import Array

N_FOLDS = 10


@dataclass(frozen=True, slots=True)
class Reading:
    """One word that was read.

    projection: of the made word's deviation from the slot's mean recorded word, on the recorded
    word's: their product over d features; recorded_square: the recorded one's with itself.
    """

    sentence: str
    slot: int
    said: str
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
    """The one fold of known words; sentences: those of `slotted`, the test among them.

    Raises CorpusError where the test holds none of them, or all.
    """
    read = tuple(u for u in sentences if u.name in test)
    fitted = [u for u in sentences if u.name not in test]
    if not read or not fitted:
        raise CorpusError(f"{len(read)} sentences to read, {len(fitted)} to learn reading from")
    slots = range(len(spoken_words(read[0])))
    return (Fold(fit_reader(kind, fitted, recorded, slots), read),)


def new_word_folds(
    kind: ReaderKind, sentences: Sequence[Utterance], words: frozenset[str], recorded: Motions
) -> tuple[Fold, ...]:
    """The folds of new words, over the slots in which they are said.

    Raises CorpusError where no sentence holds one of the words.
    """
    holding = sentences_with(words, sentences)
    slots = slots_of(words, sentences)
    missing = words - {w.text for u in holding for w in spoken_words(u)}
    if missing:
        raise CorpusError(f"no sentence holds {', '.join(map(repr, sorted(missing)))}")
    folds = []
    for first in range(min(N_FOLDS, len(holding))):
        read = tuple(holding[first::N_FOLDS])
        names = {u.name for u in read}
        fitted = [u for u in sentences if u.name not in names]
        folds.append(Fold(fit_reader(kind, fitted, recorded, slots), read))
    return tuple(folds)


def sentences_with(words: frozenset[str], sentences: Iterable[Utterance]) -> list[Utterance]:
    """Those that hold any of the words, by name."""
    holding = [u for u in sentences if words & {w.text for w in spoken_words(u)}]
    return sorted(holding, key=lambda u: u.name)


def slots_of(words: frozenset[str], sentences: Iterable[Utterance]) -> list[int]:
    """The slots in which any of the words is said."""
    return sorted({s for u in sentences for s, w in enumerate(spoken_words(u)) if w.text in words})


def read_words(folds: Iterable[Fold], made: Motions, recorded: Motions) -> list[Reading]:
    """Read every sentence of every fold in `made` motion, which `recorded` is compared with."""
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
