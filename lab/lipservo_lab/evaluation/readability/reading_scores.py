"""Scores of what was read; intervals: 95 % bootstrap over sentences (Efron 1979), percentiles."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from lipservo_lab.evaluation.readability.readings import Reading
from lipsync.arrays import Array

_N_SAMPLES = 1000


@dataclass(frozen=True, slots=True)
class ReadingScore:
    """How much was read right.

    score: of known words the mean over slots of the share read right; of new words the mean over
    the set's words of recall less false alarms (the share of a word's places that are read as it,
    less the share of other words in its slot that are). shares: what `score` is the mean of, by
    slot or by word. whole_sentences: the share of sentences with every word right; None for new
    words. gain: how far words go from their slot's mean word, projected on how far recorded ones
    go, over the latter.
    """

    score: float
    interval: tuple[float, float]
    shares: dict[str, float]
    whole_sentences: float | None
    gain: float
    n_sentences: int


def known_score(readings: Sequence[Reading], *, seed: int = 0) -> ReadingScore:
    """Of words that the model has learned; every sentence has every slot."""
    names = sorted({r.sentence for r in readings})
    slots = sorted({r.slot for r in readings})
    right = np.zeros((len(names), len(slots)))
    for reading in readings:
        place = names.index(reading.sentence), slots.index(reading.slot)
        right[place] = reading.read == reading.said
    samples = _draws(len(names), seed) @ right.mean(axis=1) / len(names)
    return ReadingScore(
        float(right.mean()),
        _interval(samples),
        {
            f"slot {slot + 1}": float(share)
            for slot, share in zip(slots, right.T.mean(axis=1), strict=True)
        },
        float(right.all(axis=1).mean()),
        gain(readings),
        len(names),
    )


def new_word_score(
    readings: Sequence[Reading], words: frozenset[str], *, seed: int = 0
) -> ReadingScore:
    """Of words that the model has never seen."""
    names = {name: n for n, name in enumerate(sorted({r.sentence for r in readings}))}
    ordered = sorted(words)
    # Of each sentence and word: said, and read; not said in the word's slot, and read.
    counts = np.zeros((len(names), len(ordered), 4))
    slots = {word: {r.slot for r in readings if r.said == word} for word in ordered}
    for reading in readings:
        for column, word in enumerate(ordered):
            if reading.slot in slots[word]:
                kind = 0 if reading.said == word else 2
                counts[names[reading.sentence], column, kind] += 1
                counts[names[reading.sentence], column, kind + 1] += reading.read == word
    totals = counts.sum(axis=0)
    drawn = np.tensordot(_draws(len(names), seed), counts, axes=1)
    samples = _recall_less_false_alarms(drawn)
    samples = samples[~np.isnan(samples).all(axis=1)]
    return ReadingScore(
        float(_recall_less_false_alarms(totals).mean()),
        _interval(np.nanmean(samples, axis=1)),
        dict(zip(ordered, map(float, _recall_less_false_alarms(totals)), strict=True)),
        None,
        gain([r for r in readings if r.said in words]),
        len(names),
    )


def gain(readings: Sequence[Reading]) -> float:
    """1: words differ as much as recorded ones; 0: not at all, or in other ways."""
    return sum(r.projection for r in readings) / sum(r.recorded_square for r in readings)


def _recall_less_false_alarms(counts: Array) -> Array:
    """(..., 4) -> (...); NaN where a drawn sample does not hold the word."""
    said, hits, others, alarms = np.moveaxis(counts, -1, 0)
    recall = np.divide(hits, said, out=np.full_like(hits, np.nan), where=said > 0)
    return np.asarray(recall - alarms / np.maximum(others, 1.0))


def _draws(n_sentences: int, seed: int) -> Array:
    """(_N_SAMPLES, n_sentences): how often each is drawn."""
    even = np.full(n_sentences, 1.0 / n_sentences)
    draws = np.random.default_rng(seed).multinomial(n_sentences, even, size=_N_SAMPLES)
    return draws.astype(np.float64)


def _interval(samples: Array) -> tuple[float, float]:
    low, high = np.percentile(samples, [2.5, 97.5])
    return float(low), float(high)
