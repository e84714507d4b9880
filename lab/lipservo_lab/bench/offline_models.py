"""What the methods that hear a whole line need, of the sentences that taught each face model."""

from lipservo_lab.baselines.context_visemes import ContextVisemes, recorded_visemes
from lipservo_lab.corpus.utterance import Corpus
from lipservo_lab.evaluation.motion.offline_methods import OfflineModels, RecordedVisemes
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipservo_lab.learning.offline.offline_training import train_offline
from lipsync.extras import check_extra
from lipsync.offline.offline_model import OfflineModel
from lipsync.offline.offline_model_file import load_offline_model


def models_of(sentences: Corpus, purpose: str) -> OfflineModels:
    """Offline models of the sentences of a corpus that trained a face model.

    For a face model of other sentences it is the shipped one, if that goes with the face:
    OfflineModelError where it does not. purpose: what asks for them. Raises MissingExtraError.
    """
    check_extra("dtaidistance", purpose)

    def train(model: TrainedModel) -> OfflineModel:
        known = _known(sentences, model)
        if known.utterances:
            return train_offline(known, model)
        shipped = load_offline_model()
        shipped.check_face(model, "the shipped offline model")
        return shipped

    return OfflineModels(train)


def visemes_of(sentences: Corpus) -> RecordedVisemes:
    """Recorded phones of the sentences of a corpus that trained a face model."""

    def gather(model: TrainedModel) -> ContextVisemes:
        known = _known(sentences, model).utterances
        return recorded_visemes(known, [model.coefficients(u.markers_mm) for u in known])

    return RecordedVisemes(gather)


def _known(sentences: Corpus, model: TrainedModel) -> Corpus:
    return sentences.labelled().keep(set(model.training_sentences))
