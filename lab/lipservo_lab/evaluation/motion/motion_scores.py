"""Scores of methods against recordings: every method, every look-ahead, one model, some sentences.

Also which sentences train and which are scored.
"""

import json
import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lipservo_lab.corpus.utterance import Corpus, CorpusError, Utterance, speech_frames
from lipservo_lab.evaluation.motion.measures import (
    Motion,
    confidence_intervals,
    figures,
    sentence_sums,
)
from lipservo_lab.evaluation.motion.methods import REFERENCE, Heard, Method, all_methods
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipsync.arrays import Array
from lipsync.face.model import FaceModel


@dataclass(frozen=True, slots=True)
class Part:
    """The sentences of one training, and those that are scored with it.

    split: name of the figure that it belongs to; train, test: names of sentences; words: only
    frames of these words are scored; None: all.
    """

    split: str
    train: frozenset[str]
    test: frozenset[str]
    words: frozenset[str] | None


def read_parts(folder: Path, corpus: Corpus) -> list[Part]:
    """Return the splits into training and test sentences that a corpus's `splits.json` names.

    They are the five folds of its entry `random`, and its splits `new_words`, whose test sentences
    have words that training lacks. Raises CorpusError for a missing or damaged file, and one that
    names none of the sentences.
    """
    return held_out_parts(
        folder, corpus, "random", lambda content: content["folds"], instead="--model needs none"
    )


def held_out_parts(
    folder: Path,
    corpus: Corpus,
    split: str,
    sets_of: Callable[[Any], Iterable[Iterable[str]]],
    *,
    new: str = "",
    instead: str,
) -> list[Part]:
    """Return the parts named by a folder's `splits.json`: those of `split`, and the new words.

    Each set of new words is one part. sets_of: returns the test sentences of each part of `split`,
    from the file's content. new: prefix for the names of sets of words. instead: hint for the error
    of a missing file, about an option that needs none. Raises CorpusError for a missing or damaged
    file, one that names none of the sentences, and a part that leaves none to train on.
    """
    path = folder / "splits.json"
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        tests = [frozenset(map(str, names)) for names in sets_of(content)]
        new_words = {str(k): frozenset(map(str, v)) for k, v in content["new_words"].items()}
    except FileNotFoundError:
        raise CorpusError(f"{path}: no such file; it says what is held out ({instead})") from None
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise CorpusError(f"{path}: not a usable list of splits ({error})") from error
    names = frozenset(u.name for u in corpus.utterances)
    parts = [Part(split, names - test, names & test, None) for test in tests if names & test]
    if not parts:
        raise CorpusError(f"{path}: names no sentence of the folder that has labels")
    parts += [words_part(f"{new}{name}", corpus, words) for name, words in new_words.items()]
    for part in parts:
        if not part.train:
            raise CorpusError(f"{path}: split {part.split} leaves no sentence to train on")
    return parts


def words_part(split: str, corpus: Corpus, words: frozenset[str]) -> Part:
    """Return a part trained without sentences that contain the words, scored on the words alone.

    Raises CorpusError for a word that no sentence contains.
    """
    words_of = {u.name: {w.text for w in u.words} for u in corpus.utterances}
    test = frozenset(name for name, texts in words_of.items() if texts & words)
    missing = sorted(words - set().union(*words_of.values()))
    if missing:
        raise CorpusError(f"{corpus.name}: no sentence holds {', '.join(map(repr, missing))}")
    return Part(split, frozenset(words_of) - test, test, words)


Listen = Callable[[Utterance], Heard]
Progress = Callable[[list[Utterance]], Iterable[Utterance]]

#: The figures that get a confidence interval.
_WITH_INTERVAL = ("ratio", "gap_r", "closure_hits")


def true_phonemes(utterance: Utterance) -> Heard:
    """Return the labels of a sentence, as a perfect recogniser would find them."""
    return Heard(utterance.phones, sound_path=utterance.sound_path)


@dataclass(frozen=True, slots=True)
class Scores:
    """Sums of every sentence (`sentence_sums`), by method name and look-ahead in ms.

    The lists may only grow.
    """

    sums: dict[tuple[str, int], list[Array]] = field(default_factory=dict)

    def row(self, strategy: str, lookahead_ms: int) -> dict[str, object]:
        """Return a method's figures, 95 % intervals (`NAME_95`) and amount of speech scored."""
        sums = np.array(self.sums[strategy, lookahead_ms])
        intervals = confidence_intervals(sums, _WITH_INTERVAL)
        found = figures(sums.sum(axis=0))
        return {
            # JSON has no NaN: figures without data are null.
            **{name: None if math.isnan(value) else value for name, value in found.items()},
            **{
                f"{name}_95": None if math.isnan(sum(interval)) else list(interval)
                for name, interval in intervals.items()
            },
            "sentences": int((sums[:, 0] > 0).sum()),
            "frames": int(sums[:, 0].sum()),
        }


def add_scores(
    scores: Scores,
    model: TrainedModel,
    utterances: Sequence[Utterance],
    methods: Sequence[Method],
    lookaheads_ms: Sequence[int],
    *,
    words: frozenset[str] | None = None,
    listen: Listen = true_phonemes,
    progress: Progress = iter,
) -> None:
    """Compute every sentence's motion by every method, and add its sums to `scores`.

    words: score only frames of these words; None: all of speech. listen: returns the phonemes that
    the methods get; the reference method always gets the labels, as its error is the denominator of
    ratios. A method that does not look ahead is run once for all look-aheads.
    """
    reference = all_methods()[REFERENCE]
    for utterance in progress(list(utterances)):
        scored = speech_frames(utterance, words)
        if not scored.any():
            continue
        times_s = np.arange(len(scored)) / utterance.frame_rate_hz
        recorded = Motion(utterance.markers_mm, model.coefficients(utterance.markers_mm))
        ideal = _motion(model, reference.faces(model, Heard(utterance.phones), times_s, 0.0))
        heard = listen(utterance)
        for method in methods:
            sums: Array | None = None
            for lookahead_ms in lookaheads_ms:
                if sums is None or method.looks_ahead:
                    faces = method.faces(model, heard, times_s, lookahead_ms / 1000.0)
                    made = _motion(model, faces)
                    sums = sentence_sums(model, utterance, scored, recorded, made, ideal)
                scores.sums.setdefault((method.name, lookahead_ms), []).append(sums)


def check_scorable(model: FaceModel, corpus: Corpus) -> tuple[Utterance, ...]:
    """Return the labelled sentences of a corpus, on which a model can be scored.

    Raises CorpusError for other markers than the model's, and for a folder without labels.
    """
    names, model_names = corpus.layout.names, model.layout.names
    if names != model_names:
        odd = sorted(set(names) ^ set(model_names))[:3]
        raise CorpusError(f"{corpus.name}: markers other than the model's ({', '.join(odd)}, ...)")
    utterances = corpus.labelled().utterances
    if not utterances:
        raise CorpusError(f"{corpus.name}: no sentence has a tier `phones` in labels/ to score by")
    return utterances


def seen_in_training(model: TrainedModel, utterances: Iterable[Utterance]) -> list[str]:
    """Return the names of sentences that the model was trained on: scores on them are too good."""
    trained = set(model.training_sentences)
    return [u.name for u in utterances if u.name in trained]


def _motion(model: FaceModel, faces: Array) -> Motion:
    return Motion(model.markers_mm(faces), faces)
