"""Figures of a study with their 95 % intervals.

Raters and sentences are both drawn anew (a cluster bootstrap each), since a study wants to speak of
other raters and other sentences. The variance of a figure is that over raters plus that over
sentences less that over their crossings, which both hold (Cameron, Gelbach and Miller, "Robust
inference with multiway clustering", 2011), each with the correction for few clusters; its degrees
of freedom are Satterthwaite's. A bootstrap that draws both at once counts the noise of a moment
three times (Owen, "The pigeonhole bootstrap", 2007) and is too wide.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import t as students_t

from lipservo_lab.study.counted import Tables
from lipsync.arrays import Array, Indices

N_DRAWS: Final = 600
#: So many comparisons are added each way, or one that was always won had no end.
_ADDED_WINS: Final = 0.1
_NEWTON_STEPS: Final = 12
_LONGEST_STEP: Final = 2.0
_CONFIDENCE: Final = 0.95


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure and the ends of its interval; None where there are too few to say."""

    value: float
    low: float | None
    high: float | None


@dataclass(frozen=True, slots=True)
class Estimates:
    """Figures of every method: itself, and less that of the reference."""

    own: tuple[Figure, ...]
    less_reference: tuple[Figure, ...]


def rated(tables: Tables, reference: int, seed: int = 0) -> Estimates:
    """Mean rating of each method, on the scale."""
    n, rows = len(tables.methods), tables.ratings
    sums = np.zeros((len(rows), 2, n))
    at = np.arange(len(rows))
    sums[at, 0, rows[:, 2]] = tables.points
    sums[at, 1, rows[:, 2]] = 1.0
    return _estimates(rows, sums, _quotient, reference, seed)


def preferred(tables: Tables, reference: int, seed: int = 0) -> Estimates:
    """Strength of each method by Bradley and Terry: log odds, with mean 0 over the methods."""
    n, rows = len(tables.methods), tables.pairs
    wins = np.zeros((len(rows), n, n))
    wins[np.arange(len(rows)), rows[:, 2], rows[:, 3]] = 1.0
    return _estimates(rows, wins, strengths, reference, seed)


def words_read(tables: Tables, reference: int, seed: int = 0) -> tuple[Estimates, Estimates]:
    """Share of words that was read right; and how far that is above chance."""
    n, rows = len(tables.methods), tables.readings
    hits, n_spoken, by_chance = tables.words.T
    found = []
    for counted in (hits, hits - by_chance):
        sums = np.zeros((len(rows), 2, n))
        at = np.arange(len(rows))
        sums[at, 0, rows[:, 2]] = counted
        sums[at, 1, rows[:, 2]] = n_spoken
        found.append(_estimates(rows, sums, _quotient, reference, seed))
    return found[0], found[1]


def _quotient(sums: Array) -> Array:
    """Return quotients, (..., n), of sums (..., 2, n); NaN where nothing was counted."""
    over, under = sums[..., 0, :], sums[..., 1, :]
    return np.divide(over, under, out=np.full_like(over, np.nan), where=under > 0)


def strengths(wins: Array) -> Array:
    """Return the most likely log odds of methods (Bradley and Terry, 1952), by Newton's steps.

    Each pair is taken to have been won 0.1 times more each way.

    Parameters
    ----------
    wins : Array
        (..., n, n), how often row was chosen over column.

    Returns
    -------
    Array
        (..., n), with mean 0.
    """
    n = wins.shape[-1]
    added = wins + _ADDED_WINS * (1.0 - np.eye(n))
    both, won = added + np.swapaxes(added, -1, -2), added.sum(axis=-1)
    found = np.zeros(won.shape)
    for _ in range(_NEWTON_STEPS):
        chance = 1.0 / (1.0 + np.exp(found[..., None, :] - found[..., :, None]))
        slope = won - (both * chance).sum(axis=-1)
        bend = -both * chance * (1.0 - chance)
        bend[..., np.arange(n), np.arange(n)] = 0.0
        # The mean is held by one more equation, or any constant would do.
        full = bend + 1.0 / n
        full[..., np.arange(n), np.arange(n)] -= bend.sum(axis=-1)
        step = np.linalg.solve(full, slope[..., None])[..., 0]
        found = found + np.clip(step, -_LONGEST_STEP, _LONGEST_STEP)
    return np.asarray(found - found.mean(axis=-1, keepdims=True))


def _estimates(
    rows: Indices, sums: Array, figures: Callable[[Array], Array], reference: int, seed: int
) -> Estimates:
    """Return estimates with intervals by rater and sentence, and differences from the reference.

    rows: (n_answers, ...), rater and sentence first. sums: (n_answers, ...), of which `figures`
    makes the estimates once they are added up.
    """
    if not len(rows):
        none = tuple(Figure(float("nan"), None, None) for _ in range(sums.shape[-1]))
        return Estimates(none, none)

    def all_figures(total: Array) -> Array:
        own = figures(total)
        return np.concatenate([own, own - own[..., reference, None]], axis=-1)

    numbers = np.random.default_rng(seed)
    crossings = rows[:, 0] * (rows[:, 1].max() + 1) + rows[:, 1]
    spreads = [
        _variance(clusters, sums, all_figures, numbers)
        for clusters in (rows[:, 0], rows[:, 1], crossings)
    ]
    values = all_figures(sums.sum(axis=0))
    (by_rater, n_raters), (by_sentence, n_sentences), (by_both, _) = spreads
    variance = np.maximum(by_rater + by_sentence - by_both, np.maximum(by_rater, by_sentence))
    with np.errstate(divide="ignore", invalid="ignore"):
        freedom = (by_rater + by_sentence) ** 2 / (
            by_rater**2 / (n_raters - 1) + by_sentence**2 / (n_sentences - 1)
        )
    reach = students_t.ppf(0.5 + _CONFIDENCE / 2.0, freedom) * np.sqrt(variance)
    found = [
        Figure(float(value), float(value - far), float(value + far))
        if np.isfinite(far)
        else Figure(float(value), None, None)
        for value, far in zip(values, reach, strict=True)
    ]
    # The reference less itself is exactly 0, and no estimate.
    n = len(found) // 2
    found[n + reference] = Figure(0.0, None, None)
    return Estimates(tuple(found[:n]), tuple(found[n:]))


def _variance(
    clusters: Indices, sums: Array, figures: Callable[[Array], Array], numbers: np.random.Generator
) -> tuple[Array, int]:
    """Return the bootstrap variance of figures over clusters, and how many clusters there are.

    NaN for fewer than two clusters.
    """
    names, number = np.unique(clusters, return_inverse=True)
    n = len(names)
    if n < 2:
        return np.full(figures(sums.sum(axis=0)).shape, np.nan), n
    of_cluster = np.zeros((n, *sums.shape[1:]))
    np.add.at(of_cluster, number, sums)
    drawn = numbers.multinomial(n, np.full(n, 1.0 / n), size=N_DRAWS).astype(np.float64)
    samples = figures(np.tensordot(drawn, of_cluster, axes=1))
    whole = ~np.isnan(samples).any(axis=1)
    if whole.sum() < N_DRAWS / 2:
        return np.full(samples.shape[1], np.nan), n
    return samples[whole].var(axis=0) * n / (n - 1), n
