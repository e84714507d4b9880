"""The models whose motion is read: given, or trained without what is read of them."""

from collections.abc import Callable, Sequence
from pathlib import Path

from lipservo_lab.bench.left_out_words import KeptModels, cache_folder
from lipservo_lab.bench.motion_figures import BenchError
from lipservo_lab.corpus.utterance import Corpus, CorpusError
from lipservo_lab.evaluation.motion.motion_scores import Part, words_part
from lipservo_lab.evaluation.readability.reading_scores import reading_parts
from lipservo_lab.learning.motion.model_teacher import ModelTeacher, Track
from lipservo_lab.learning.motion.trained_model import TrainedModel, load_trained_model
from lipsync.recognition.network import DEFAULT_WEIGHTS, load_weights, weights_digest

ModelOf = Callable[[Part], TrainedModel]

_NEW = "new_"


def requested_parts(folder: Path, corpus: Corpus, words: str | None) -> list[Part]:
    """Return the parts to be read: those of the folder's splits.json, or one with `words`.

    The former are sentences of known words, and sets of new words. corpus: labelled. words: with
    commas between; None: read splits.json. Raises BenchError or CorpusError for what cannot be held
    out.
    """
    if words is None:
        return reading_parts(folder, corpus)
    named = frozenset(word.strip() for word in words.split(",") if word.strip())
    if not named:
        raise BenchError("--words names no word")
    part = words_part(f"{_NEW}words", corpus, named)
    if not part.train:
        raise CorpusError(
            f"{corpus.name}: every labelled sentence holds one of these words, so none is left to "
            "train on; name rarer words"
        )
    return [part]


def model_file(part: Part) -> str:
    """Return the file name of a part's model: `known.npz`, `a.npz`, `words.npz`."""
    return f"{part.split.removeprefix(_NEW)}.npz"


def given_models(folder: Path, parts: Sequence[Part]) -> ModelOf:
    """Read the models of a folder; return a function from a part to its model.

    Raises ModelError for a file that cannot be read, BenchError for a model that was trained on a
    sentence that it is tested on.
    """
    models = {}
    for part in parts:
        path = folder / model_file(part)
        model = load_trained_model(path)
        seen = sorted(part.test.intersection(model.training_sentences))
        if seen:
            raise BenchError(
                f"{path}: was trained on {len(seen)} of the sentences to be read ({seen[0]}, ...); "
                "give one trained without them, or leave --models out"
            )
        models[part.split] = model
    return lambda part: models[part.split]


def trained_models(corpus: Corpus, track: Track, tell: Callable[[str], None]) -> ModelOf:
    """Return a function that trains a model on the training sentences of a split (`Part`).

    Each call trains a model. Training also needs what the recogniser hears of the corpus: it runs
    over all sentences once, at the first call, and track shows its progress. tell: called with
    lines that say what training is doing.
    """
    teacher = ModelTeacher(corpus, DEFAULT_WEIGHTS, track, tell)
    return lambda part: teacher(corpus.keep(set(part.train)))


def kept_models(
    corpus: Corpus, track: Track, tell: Callable[[str], None], others: Sequence[Path]
) -> ModelOf:
    """Return a function from a part to its model, trained at the first use and kept on disk.

    `bench motion --leave-words-out` uses the same models. track, tell: as in `trained_models`.
    others: files of further weights by which the sentences are recognised for training.
    """
    weights = [load_weights(path) for path in others]
    digests = tuple(weights_digest(str(path)) for path in others)
    teacher = ModelTeacher(corpus, DEFAULT_WEIGHTS, track, tell, weights)
    return KeptModels(cache_folder(), corpus, teacher.heard, teacher, digests).of
