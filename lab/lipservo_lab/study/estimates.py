"""Figures of a study with their 95 % intervals.

Raters and sentences are each resampled (a cluster bootstrap each), since a study shall hold for
other raters and other sentences. The variance of a figure is that over raters plus that over
sentences less that over their crossings, which is contained in both (Cameron, Gelbach and Miller,
"Robust inference with multiway clustering", 2011), each with the correction for few clusters; its
degrees of freedom are Satterthwaite's. A bootstrap that resamples both at once counts the noise of
a single answer three times (Owen, "The pigeonhole bootstrap", 2007) and is too wide.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import t as students_t

from lipservo_lab.study.counted import Tables
from lipsync.arrays import Array, Indices

N_DRAWS: Final = 600
#: Comparisons added to each pair, each way: a method that always won would have infinite strength.
_ADDED_WINS: Final = 0.1
_NEWTON_STEPS: Final = 12
_LONGEST_STEP: Final = 2.0
_CONFIDENCE: Final = 0.95


@dataclass(frozen=True, slots=True)
class Figure:
    """A figure and the ends of its 95 % interval; None if there are too few answers for one."""

    value: float
    low: float | None
    high: float | None


@dataclass(frozen=True, slots=True)
class Estimates:
    """Figures of each method: itself (own), and less that of the reference."""

    own: tuple[Figure, ...]
    less_reference: tuple[Figure, ...]


def rated(tables: Tables, reference: int, seed: int = 0) -> Estimates:
    """Return the mean rating of each method, in points.

    reference: index of the method for differences. seed: of the bootstrap.
    """
    n, rows = len(tables.methods), tables.ratings
    sums = np.zeros((len(rows), 2, n))
    answers = np.arange(len(rows))
    sums[answers, 0, rows[:, 2]] = tables.points
    sums[answers, 1, rows[:, 2]] = 1.0
    return _estimates(rows, sums, _quotient, reference, seed)


def preferred(tables: Tables, reference: int, seed: int = 0) -> Estimates:
    """Return the strength of each method by Bradley and Terry: log odds, of mean 0 over methods.

    reference: index of the method for differences. seed: of the bootstrap.
    """
    n, rows = len(tables.methods), tables.pairs
    wins = np.zeros((len(rows), n, n))
    wins[np.arange(len(rows)), rows[:, 2], rows[:, 3]] = 1.0
    return _estimates(rows, wins, strengths, reference, seed)


def words_read(tables: Tables, reference: int, seed: int = 0) -> tuple[Estimates, Estimates]:
    """Return the share of words read correctly, and how far it is above chance, for each method.

    reference: index of the method for differences. seed: of the bootstrap.
    """
    n, rows = len(tables.methods), tables.readings
    hits, n_spoken, by_chance = tables.words.T
    estimates = []
    for n_right in (hits, hits - by_chance):
        sums = np.zeros((len(rows), 2, n))
        answers = np.arange(len(rows))
        sums[answers, 0, rows[:, 2]] = n_right
        sums[answers, 1, rows[:, 2]] = n_spoken
        estimates.append(_estimates(rows, sums, _quotient, reference, seed))
    return estimates[0], estimates[1]


def _quotient(sums: Array) -> Array:
    """Return quotients, (..., n), of sums (..., 2, n), first over second; NaN where that is 0."""
    over, under = sums[..., 0, :], sums[..., 1, :]
    return np.divide(over, under, out=np.full_like(over, np.nan), where=under > 0)


def strengths(wins: Array) -> Array:
    """Return the most likely log odds of methods (Bradley and Terry, 1952), by Newton's method.

    Each pair counts as won 0.1 times more each way.

    Parameters
    ----------
    wins : Array
        (..., n, n), how often the row was chosen over the column.

    Returns
    -------
    Array
        (..., n), with mean 0.
    """
    n = wins.shape[-1]
    added = wins + _ADDED_WINS * (1.0 - np.eye(n))
    n_played, won = added + np.swapaxes(added, -1, -2), added.sum(axis=-1)
    found = np.zeros(won.shape)
    for _ in range(_NEWTON_STEPS):
        chance = 1.0 / (1.0 + np.exp(found[..., None, :] - found[..., :, None]))
        gradient = won - (n_played * chance).sum(axis=-1)
        hessian = -n_played * chance * (1.0 - chance)
        hessian[..., np.arange(n), np.arange(n)] = 0.0
        # Without a condition on the mean any constant could be added, and the matrix is singular.
        solvable = hessian + 1.0 / n
        solvable[..., np.arange(n), np.arange(n)] -= hessian.sum(axis=-1)
        step = np.linalg.solve(solvable, gradient[..., None])[..., 0]
        found = found + np.clip(step, -_LONGEST_STEP, _LONGEST_STEP)
    return np.asarray(found - found.mean(axis=-1, keepdims=True))


def _estimates(
    rows: Indices, sums: Array, figures: Callable[[Array], Array], reference: int, seed: int
) -> Estimates:
    """Return estimates with intervals, and their differences from the reference.

    rows: (n_answers, ...), rater and sentence first. sums: (n_answers, ...), parts of each answer;
    the sum over answers is what `figures` makes the estimates of.
    """
    if not len(rows):
        unknown = tuple(Figure(float("nan"), None, None) for _ in range(sums.shape[-1]))
        return Estimates(unknown, unknown)

    def all_figures(total: Array) -> Array:
        of_methods = figures(total)
        return np.concatenate([of_methods, of_methods - of_methods[..., reference, None]], axis=-1)

    rng = np.random.default_rng(seed)
    crossings = rows[:, 0] * (rows[:, 1].max() + 1) + rows[:, 1]
    variances = [
        _variance(clusters, sums, all_figures, rng)
        for clusters in (rows[:, 0], rows[:, 1], crossings)
    ]
    values = all_figures(sums.sum(axis=0))
    (by_rater, n_raters), (by_sentence, n_sentences), (by_both, _) = variances
    variance = np.maximum(by_rater + by_sentence - by_both, np.maximum(by_rater, by_sentence))
    with np.errstate(divide="ignore", invalid="ignore"):
        degrees = (by_rater + by_sentence) ** 2 / (
            by_rater**2 / (n_raters - 1) + by_sentence**2 / (n_sentences - 1)
        )
    half_widths = students_t.ppf(0.5 + _CONFIDENCE / 2.0, degrees) * np.sqrt(variance)
    all_found = [
        Figure(float(value), float(value - half_width), float(value + half_width))
        if np.isfinite(half_width)
        else Figure(float(value), None, None)
        for value, half_width in zip(values, half_widths, strict=True)
    ]
    # The difference of the reference from itself is exactly 0.
    n = len(all_found) // 2
    all_found[n + reference] = Figure(0.0, None, None)
    return Estimates(tuple(all_found[:n]), tuple(all_found[n:]))


def _variance(
    clusters: Indices, sums: Array, figures: Callable[[Array], Array], rng: np.random.Generator
) -> tuple[Array, int]:
    """Return the bootstrap variance of figures over clusters, and the number of clusters.

    clusters: (n_answers,), the cluster of each answer. NaN for fewer than two clusters, or if most
    samples lack a figure.
    """
    names, cluster_of = np.unique(clusters, return_inverse=True)
    n = len(names)
    if n < 2:
        return np.full(figures(sums.sum(axis=0)).shape, np.nan), n
    of_cluster = np.zeros((n, *sums.shape[1:]))
    np.add.at(of_cluster, cluster_of, sums)
    draws = rng.multinomial(n, np.full(n, 1.0 / n), size=N_DRAWS).astype(np.float64)
    samples = figures(np.tensordot(draws, of_cluster, axes=1))
    complete = ~np.isnan(samples).any(axis=1)
    if complete.sum() < N_DRAWS / 2:
        return np.full(samples.shape[1], np.nan), n
    return samples[complete].var(axis=0) * n / (n - 1), n
