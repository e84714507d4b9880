"""Train models of several parts of one corpus; its sentences are recognised once for all of them.

For evaluation, the sentences to be scored are left out of each part. The recogniser was trained on
no sentence of the corpus, so its output serves every part alike.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cached_property

from lipservo_lab.corpus.utterance import Corpus, Utterance
from lipservo_lab.learning.expectation.deviation import hear_sentences
from lipservo_lab.learning.expectation.soft_training import (
    HeardCopies,
    fit_soft_expectation,
    hear_copies,
)
from lipservo_lab.learning.motion.face_training import TrainingError, train
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipsync.recognition.network import NetworkWeights, find_weights, weights_digest

Track = Callable[[str, Sequence[Utterance]], Iterable[Utterance]]


class ModelTeacher:
    """Trains models: called with a part of the corpus, it returns the model of that part."""

    def __init__(
        self,
        corpus: Corpus,
        weights: str,
        track: Track,
        progress: Callable[[str], None],
        others: Sequence[NetworkWeights] = (),
    ) -> None:
        """Recognise all sentences of a labelled corpus.

        weights: of the recogniser, a name or a file. track: returns the sentences again, and shows
        a bar with a line about the work as they are taken. progress: called with a line about what
        is being trained. others: weights of further recognisers, whose posteriors of the sentences
        serve the map from posteriors too.
        """
        self._corpus = corpus
        self._weights = find_weights(weights)
        self._digest = weights_digest(weights)
        self._others = others
        self._track = track
        self._progress = progress
        self.heard = hear_sentences(
            self._weights, corpus.utterances, lambda items: track("listening", items)
        )

    @cached_property
    def copies(self) -> HeardCopies:
        """Posteriors of every sentence as several voices (`hear_copies`).

        Computed at first use, in three minutes for 44 of speech.
        """
        return hear_copies(self._weights, self._corpus.utterances, self._track, self._others)

    def __call__(self, part: Corpus) -> TrainedModel:
        """Return a model of a part of the corpus, with a map from posteriors to faces.

        Raises TrainingError for a part that `train` cannot learn from.
        """
        model = train(part, heard=self.heard, progress=self._progress)
        self._progress("posteriors to faces")
        return with_soft_expectation(model, part, self.copies, self._digest)


def with_soft_expectation(
    model: TrainedModel, corpus: Corpus, copies: HeardCopies, digest: str
) -> TrainedModel:
    """Return the model with a map from posteriors to faces, learned from the model's own sentences.

    copies: posteriors of all sentences. digest: of the weights that these were computed with, for
    the provenance. With too few frames `soft` is None. Raises TrainingError if sentences that the
    model learned are missing in the corpus.
    """
    utterances = taught_sentences(model, corpus)
    coefficients = [model.coefficients(u.markers_mm) for u in utterances]
    soft = fit_soft_expectation(utterances, coefficients, copies)
    return replace(model, soft=soft, provenance={**model.provenance, "soft_weights": digest})


def taught_sentences(model: TrainedModel, corpus: Corpus) -> tuple[Utterance, ...]:
    """Return the sentences of a corpus that a model has learned.

    Raises TrainingError if the corpus lacks some of them.
    """
    known = set(model.training_sentences)
    utterances = corpus.labelled().keep(known).utterances
    if len(utterances) != len(known):
        raise TrainingError(
            f"corpus {corpus.name}: {len(known) - len(utterances)} of the model's "
            f"{len(known)} sentences are not in it; give the folder that the model was made of"
        )
    return utterances
