"""Names of array types for the type checker, and long computations in bounded memory."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: Shapes and units stand where each is used. `Array32`: what a recogniser computes with.
Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Indices = NDArray[np.int64]

#: Of a line's frames, 100 a second, so many are computed at once.
_ROWS_AT_ONCE = 256


def in_blocks(compute: Callable[[slice], NDArray[Any]], n: int) -> NDArray[Any]:
    """Return the rows 0 to n - 1 of a long computation, computed by slices, end to end.

    Parameters
    ----------
    compute : Callable
        From a slice of the rows to these rows.
    n : int
        How many rows there are.

    Returns
    -------
    NDArray
        (n, ...).
    """
    if n <= _ROWS_AT_ONCE:
        return compute(slice(n))
    starts = range(0, n, _ROWS_AT_ONCE)
    return np.concatenate([compute(slice(at, at + _ROWS_AT_ONCE)) for at in starts])
