"""Ratings by a linear mixed model, beside the bootstrap: statsmodels, the extra `study`.

points = method + rater + sentence + rater's taste for the method + noise, each but the first a
normal variable (Baayen, Davidson and Bates, "Mixed-effects modeling with crossed random effects for
subjects and items", 2008), fitted by restricted maximum likelihood. Unlike the bootstrap it assumes
even steps of the scale, and normal parts.
"""

import warnings
from dataclasses import dataclass

import numpy as np

from lipservo_lab.study.counted import Tables
from lipservo_lab.study.estimates import Figure
from lipsync.arrays import Array, Indices
from lipsync.errors import check_extra

_NORMAL_95 = 1.959964


@dataclass(frozen=True, slots=True)
class MixedModel:
    """A fitted mixed model.

    own: mean of each method, in points; less_reference: differences from the reference. spread:
    standard deviation of each part of the sum, by name.
    """

    own: tuple[Figure, ...]
    less_reference: tuple[Figure, ...]
    spread: dict[str, float]


def mixed_model(tables: Tables, reference: int) -> MixedModel | None:
    """Fit a mixed model to the ratings; return None if there are too few.

    That is: fewer than two raters or sentences, a method without ratings, or fewer than two ratings
    a method. reference: index of the method for differences. Raises MissingExtraError.
    """
    check_extra("statsmodels", "a linear mixed model")
    from statsmodels.regression.mixed_linear_model import MixedLM, VCSpec

    rater, sentence, method = tables.ratings.T
    n = len(tables.methods)
    present = [len(np.unique(each)) for each in (rater, sentence, method)]
    if present[0] < 2 or present[1] < 2 or present[2] < n or len(rater) < 2 * n:
        return None
    parts = {"rater": rater, "sentence": sentence, "taste": rater * n + method}
    designs = [[_indicators(each)] for each in parts.values()]
    columns = [[[str(k) for k in range(each[0].shape[1])]] for each in designs]
    with warnings.catch_warnings():
        # A part without variance lies on the boundary, which is a result.
        warnings.simplefilter("ignore")
        fitted = MixedLM(
            tables.points,
            _indicators(method),
            groups=np.zeros(len(rater)),
            exog_re=None,
            exog_vc=VCSpec(list(parts), columns, designs),
        ).fit(reml=True, method="lbfgs")
    own, covariance = np.asarray(fitted.fe_params), np.asarray(fitted.cov_params())[:n, :n]
    differences = np.eye(n) - np.eye(n)[reference]
    spread = {name: float(np.sqrt(v)) for name, v in zip(parts, fitted.vcomp, strict=True)}
    return MixedModel(
        _figures(own, covariance),
        _figures(differences @ own, differences @ covariance @ differences.T),
        spread | {"moment": float(np.sqrt(fitted.scale))},
    )


def _indicators(numbers: Indices) -> Array:
    """Return a column of 0 and 1 for each number that occurs, (n, k)."""
    found = np.unique(numbers, return_inverse=True)[1]
    return np.eye(found.max() + 1)[found]


def _figures(values: Array, covariance: Array) -> tuple[Figure, ...]:
    """Return values with 95 % intervals of a normal distribution; none for a variance of 0."""
    half_widths = _NORMAL_95 * np.sqrt(np.diag(covariance))
    return tuple(
        Figure(float(v), float(v - d), float(v + d)) if d > 0 else Figure(float(v), None, None)
        for v, d in zip(values, half_widths, strict=True)
    )
