"""What the methods that hear a whole line need, of the sentences that taught each face model."""

from lipservo_lab.baselines.context_visemes import ContextVisemes, recorded_visemes
from lipservo_lab.corpus.utterance import Corpus
from lipservo_lab.evaluation.motion.offline_methods import OfflineModels, RecordedVisemes
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipservo_lab.learning.offline.offline_training import train_offline
from lipsync.errors import check_extra
from lipsync.offline.offline_model import OfflineModel
from lipsync.offline.offline_model_file import load_offline_model


def models_of(sentences: Corpus, purpose: str) -> OfflineModels:
    """Return a source of offline models that trains one for each face model that asks for one.

    It trains on the sentences of `sentences` that trained the face model. The shipped face model,
    and one of whose sentences none is in `sentences`, get the shipped offline model; raises
    OfflineModelError where that does not fit. Raises MissingExtraError, which names `purpose`.
    """
    check_extra("dtaidistance", purpose)

    def train(model: TrainedModel) -> OfflineModel:
        trained_on, shipped = _training_corpus(sentences, model), load_offline_model()
        if trained_on.utterances and shipped.face_checksum != model.checksum:
            return train_offline(trained_on, model)
        shipped.check_face(model, "the shipped offline model")
        return shipped

    return OfflineModels(train)


def visemes_of(sentences: Corpus) -> RecordedVisemes:
    """Return a source of recorded phones, with the face model's coefficients of each frame.

    The phones are of the sentences of `sentences` that trained the face model.
    """

    def gather(model: TrainedModel) -> ContextVisemes:
        utterances = _training_corpus(sentences, model).utterances
        return recorded_visemes(utterances, [model.coefficients(u.markers_mm) for u in utterances])

    return RecordedVisemes(gather)


def _training_corpus(sentences: Corpus, model: TrainedModel) -> Corpus:
    """Return the labelled sentences of a corpus that trained a face model."""
    return sentences.labelled().keep(set(model.training_sentences))
