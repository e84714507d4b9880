"""Whole models of parts of one corpus, whose sentences are listened to once for all of them.

What is scored is left out of a part; the recogniser has never heard a sentence of the corpus, so
what it makes of them serves every part alike.
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
    """Call it with a part of the corpus for the model that learned it."""

    def __init__(
        self,
        corpus: Corpus,
        weights: str,
        track: Track,
        tell: Callable[[str], None],
        others: Sequence[NetworkWeights] = (),
    ) -> None:
        """Recognise all sentences of a labelled corpus beforehand.

        weights: of the recogniser, a name or a file. track: wraps the sentences, for progress;
        tell: called with what is being trained. others: further weights that recognise the
        sentences, for the map from posteriors.
        """
        self._corpus = corpus
        self._weights = find_weights(weights)
        self._digest = weights_digest(weights)
        self._others = others
        self._track = track
        self._tell = tell
        self.heard = hear_sentences(
            self._weights, corpus.utterances, lambda items: track("listening", items)
        )

    @cached_property
    def copies(self) -> HeardCopies:
        """Posteriors of every sentence in every voice: three minutes for 44 of speech."""
        return hear_copies(self._weights, self._corpus.utterances, self._track, self._others)

    def __call__(self, part: Corpus) -> TrainedModel:
        """Raises TrainingError for what `train` cannot learn from."""
        model = train(part, heard=self.heard, progress=self._tell)
        self._tell("posteriors to faces")
        return with_soft_expectation(model, part, self.copies, self._digest)


def with_soft_expectation(
    model: TrainedModel, corpus: Corpus, copies: HeardCopies, digest: str
) -> TrainedModel:
    """The model with a map from posteriors, learned from the sentences that taught the model.

    digest: of the weights that the copies were heard with. A corpus too small for a map leaves the
    model without one. Raises TrainingError where the model learned other sentences.
    """
    utterances = taught_sentences(model, corpus)
    coefficients = [model.coefficients(u.markers_mm) for u in utterances]
    soft = fit_soft_expectation(utterances, coefficients, copies)
    return replace(model, soft=soft, provenance={**model.provenance, "soft_weights": digest})


def taught_sentences(model: TrainedModel, corpus: Corpus) -> tuple[Utterance, ...]:
    """Return the sentences of a corpus that a model has learned.

    Raises TrainingError where some are missing.
    """
    known = set(model.training_sentences)
    utterances = corpus.labelled().keep(known).utterances
    if len(utterances) != len(known):
        raise TrainingError(
            f"corpus {corpus.name}: {len(known) - len(utterances)} of the model's "
            f"{len(known)} sentences are not in it; give the folder that the model was made of"
        )
    return utterances
