"""Scores of words that readers read; intervals are 95 % bootstrap over sentences (Efron 1979).

Read are known words of held-out sentences, and sets of words that a model was trained without.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lipservo_lab.corpus.utterance import Corpus, Utterance
from lipservo_lab.evaluation.motion.methods import Method
from lipservo_lab.evaluation.motion.motion_scores import Listen, Part, held_out_parts
from lipservo_lab.evaluation.readability.readers import (
    MARGIN_S,
    Motions,
    ReaderKind,
    Reading,
    spoken_words,
)
from lipservo_lab.learning.motion.trained_model import TrainedModel
from lipsync.arrays import Array
from lipsync.face.model import FaceModel

KNOWN = "known"


def reading_parts(folder: Path, corpus: Corpus) -> list[Part]:
    """Return part `known`, the sentences of `random_test`, and `new_a`, ...: sets of new words.

    folder: with a `splits.json`. corpus: labelled. Raises CorpusError for a missing or damaged
    splits.json, one whose `random_test` holds none or all of the sentences, and a set that leaves
    none to train on.
    """
    parts = held_out_parts(
        folder,
        corpus,
        KNOWN,
        lambda content: [content["random_test"]],
        new="new_",
        instead="--words names words instead",
    )
    return [replace(part, split=part.split.lower()) for part in parts]


_N_SAMPLES = 1000


@dataclass(frozen=True, slots=True)
class ReadingScore:
    """How much was read correctly.

    score: for known words the mean over slots of the share read correctly; for new words the mean
    over the words of recall less false alarms (share of a word's occurrences that are read as it,
    less the share of other words in its slots that are). samples: the score on each bootstrap
    sample; these are the same for the same sentences, so that two scores may be compared in pairs.
    shares: what `score` is the mean of, by slot or by word. whole_sentences: share of sentences
    with every word correct; None for new words. gain: see `gain`.
    """

    score: float
    samples: Array
    shares: dict[str, float]
    whole_sentences: float | None
    gain: float
    n_sentences: int

    @property
    def interval(self) -> tuple[float, float]:
        """The ends of the 95 % interval of the score."""
        return percentiles(self.samples)


def known_score(readings: Sequence[Reading], *, seed: int = 0) -> ReadingScore:
    """Return the score of words that the model has learned.

    Every sentence has a reading in every slot.
    """
    names = sorted({r.sentence for r in readings})
    slots = sorted({r.slot for r in readings})
    is_right = np.zeros((len(names), len(slots)))
    for reading in readings:
        place = names.index(reading.sentence), slots.index(reading.slot)
        is_right[place] = reading.read == reading.spoken
    samples = _draws(len(names), seed) @ is_right.mean(axis=1) / len(names)
    return ReadingScore(
        float(is_right.mean()),
        samples,
        {
            f"slot {slot + 1}": float(share)
            for slot, share in zip(slots, is_right.T.mean(axis=1), strict=True)
        },
        float(is_right.all(axis=1).mean()),
        gain(readings),
        len(names),
    )


def new_word_score(
    readings: Sequence[Reading], words: frozenset[str], *, seed: int = 0
) -> ReadingScore:
    """Return the score of `words`, which the model was not trained on."""
    names = {name: n for n, name in enumerate(sorted({r.sentence for r in readings}))}
    ordered = sorted(words)
    # For each sentence and word: times spoken, of these read as it; times another word was spoken
    # in a slot of the word, of these read as it.
    counts = np.zeros((len(names), len(ordered), 4))
    slots = {word: {r.slot for r in readings if r.spoken == word} for word in ordered}
    for reading in readings:
        for column, word in enumerate(ordered):
            if reading.slot in slots[word]:
                kind = 0 if reading.spoken == word else 2
                counts[names[reading.sentence], column, kind] += 1
                counts[names[reading.sentence], column, kind + 1] += reading.read == word
    totals = counts.sum(axis=0)
    drawn = np.tensordot(_draws(len(names), seed), counts, axes=1)
    samples = _recall_less_false_alarms(drawn)
    samples = np.nanmean(samples[~np.isnan(samples).all(axis=1)], axis=1)
    return ReadingScore(
        float(_recall_less_false_alarms(totals).mean()),
        samples,
        dict(zip(ordered, map(float, _recall_less_false_alarms(totals)), strict=True)),
        None,
        gain([r for r in readings if r.spoken in words]),
        len(names),
    )


def gain(readings: Sequence[Reading]) -> float:
    """Return how far words deviate from their slot's mean word, over how far recorded ones do.

    Deviations are projected on the recorded ones. 1: words differ as much as recorded ones; 0: not
    at all, or in other ways.
    """
    return sum(r.projection for r in readings) / sum(r.recorded_square for r in readings)


def _recall_less_false_alarms(counts: Array) -> Array:
    """Return recall less false alarms, (...), of counts (..., 4) as `new_word_score` makes them.

    NaN where the word is never spoken, as in some bootstrap samples.
    """
    n_spoken, hits, n_others, false_alarms = np.moveaxis(counts, -1, 0)
    recall = np.divide(hits, n_spoken, out=np.full_like(hits, np.nan), where=n_spoken > 0)
    return np.asarray(recall - false_alarms / np.maximum(n_others, 1.0))


def _draws(n_sentences: int, seed: int) -> Array:
    """Return how often each sentence is drawn in bootstrap samples, (_N_SAMPLES, n_sentences)."""
    even = np.full(n_sentences, 1.0 / n_sentences)
    draws = np.random.default_rng(seed).multinomial(n_sentences, even, size=_N_SAMPLES)
    return draws.astype(np.float64)


def percentiles(samples: Array) -> tuple[float, float]:
    """Return the ends of the 95 % interval of bootstrap samples.

    Parameters
    ----------
    samples : Array
        (n,), the figure in each sample.
    """
    low, high = np.percentile(samples, [2.5, 97.5])
    return float(low), float(high)


def recorded_motions(model: FaceModel, sentences: Iterable[Utterance], kind: ReaderKind) -> Motions:
    """Return recorded faces by sentence, as a reader sees them, at the frames of the recording."""
    return {u.name: kind.view(model, u.markers_mm) for u in sentences}


def seen_motions(model: FaceModel, faces: Motions, kind: ReaderKind) -> Motions:
    """Return faces, (n_frames, n_components) by sentence name, as a reader sees them."""
    return {name: kind.view(model, model.markers_mm(each)) for name, each in faces.items()}


def made_faces(
    model: TrainedModel,
    sentences: Iterable[Utterance],
    method: Method,
    lookahead_s: float,
    listen: Listen,
    rate_hz: float | None = None,
) -> Motions:
    """Return a method's faces, (n_frames, n_components), for each sentence by name.

    They end after the last word. listen: returns the phonemes that the method gets. rate_hz: frames
    a second; None: the recording's.
    """
    made = {}
    for utterance in sentences:
        rate = rate_hz or utterance.frame_rate_hz
        duration_s = len(utterance.markers_mm) / utterance.frame_rate_hz
        until_s = min(duration_s, seen_until_s(utterance))
        times_s = np.arange(0.0, until_s, 1.0 / rate)
        made[utterance.name] = method.faces(model, listen(utterance), times_s, lookahead_s)
    return made


def seen_until_s(utterance: Utterance) -> float:
    """Return until when a reader needs frames of a sentence, s: one frame after the last margin."""
    return spoken_words(utterance)[-1].end_s + MARGIN_S + 1.0 / utterance.frame_rate_hz
