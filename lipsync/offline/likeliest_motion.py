"""The likeliest motion through a sequence of states: one block-banded linear system.

Edge, Hilton and Jackson, step 6 of synthesis, after Brand, "Voice puppetry", SIGGRAPH 1999.
"""

import numpy as np
from scipy.linalg import solveh_banded

from lipsync.arrays import Array


def likeliest_trajectory(
    means: Array,
    precisions: Array,
    expected: Array | None = None,
    expected_precision: Array | None = None,
) -> Array:
    """Positions (n, p) that maximise the product over t of N(y~_t; 0, K_t), equation (4).

    y~_t = (x_t, x_{t+1} - x_t) - mu_t; in the last frame the speed is that of the step before.
    means: (n, 2 p), mu_t of each frame's state; precisions: (n, 2 p, 2 p), the inverse of K_t.
    With W the matrix that takes positions to positions and speeds: W' K^-1 W x = W' K^-1 mu, which
    is symmetric, positive definite, and p by p blocks around the diagonal.

    expected (n, p), expected_precision (p, p): what else is known of each position, one more
    Gaussian a frame: not of the paper.
    """
    n, p = len(means), means.shape[1] // 2
    diagonal = np.zeros((n, p, p))
    below = np.zeros((max(n - 1, 0), p, p))
    right = np.zeros((n, p))
    # K^-1 in its four blocks, and K^-1 mu in its two.
    xx, xv, vv = precisions[:, :p, :p], precisions[:, :p, p:], precisions[:, p:, p:]
    weighted = np.einsum("tij,tj->ti", precisions, means)
    at_x, at_v = weighted[:, :p], weighted[:, p:]
    diagonal += xx
    right += at_x
    if n > 1:
        # Speeds from the frame to the next: x_t has -1 in them, x_{t+1} has 1.
        on = slice(0, n - 1)
        crossed = xv.transpose(0, 2, 1)
        diagonal[:-1] += vv[on] - xv[on] - crossed[on]
        diagonal[1:] += vv[on]
        below += crossed[on] - vv[on]
        right[:-1] -= at_v[on]
        right[1:] += at_v[on]
        # The last frame's speed is from the frame before to it.
        diagonal[-1] += vv[-1] + xv[-1] + crossed[-1]
        diagonal[-2] += vv[-1]
        below[-1] -= vv[-1] + xv[-1]
        right[-1] += at_v[-1]
        right[-2] -= at_v[-1]
    if expected is not None and expected_precision is not None:
        diagonal += expected_precision
        right += expected @ expected_precision
    if n == 1:
        return np.linalg.solve(diagonal[0], right[0])[None]
    solved = solveh_banded(banded(diagonal, below), right.ravel(), lower=True, check_finite=False)
    return np.asarray(solved, dtype=np.float64).reshape(n, p)


def banded(diagonal: Array, below: Array) -> Array:
    """The lower bands (2 p, n p) of a block-tridiagonal symmetric matrix, as SciPy stores them.

    diagonal: (n, p, p); below: (n - 1, p, p), the blocks under it.
    """
    n, p = diagonal.shape[:2]
    bands = np.zeros((2 * p, n, p))
    for row in range(p):
        for column in range(p):
            if row >= column:
                bands[row - column, :, column] = diagonal[:, row, column]
            bands[p + row - column, : n - 1, column] = below[:, row, column]
    return bands.reshape(2 * p, n * p)
