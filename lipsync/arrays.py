"""Names of array types for the type checker, and long computations in bounded memory."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Shapes and units stand where each is used. `Array32`: what a recogniser computes with.
Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Indices = NDArray[np.int64]

#: So many rows are computed at once, of a line's frames 2.56 s.
_ROWS_AT_ONCE = 256


def in_blocks(compute: Callable[[slice], NDArray[Any]], n: int) -> NDArray[Any]:
    """Return rows 0 to n - 1 of a long computation, which is done in blocks of 256 rows.

    Parameters
    ----------
    compute : Callable
        Returns the rows of the slice that it gets.
    n : int
        Number of rows.

    Returns
    -------
    NDArray
        (n, ...).
    """
    if n <= _ROWS_AT_ONCE:
        return compute(slice(n))
    starts = range(0, n, _ROWS_AT_ONCE)
    return np.concatenate([compute(slice(first, first + _ROWS_AT_ONCE)) for first in starts])
