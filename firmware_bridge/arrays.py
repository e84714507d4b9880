"""The array that angles, speeds and times come in, and questions about a few flags."""

import numpy as np
from numpy.typing import NDArray

#: float64 of any shape; docstrings say which.
Array = NDArray[np.float64]


def any_set(values: NDArray[np.bool_] | NDArray[np.number]) -> bool:
    """Whether any is not 0; for as many as a face has joints, ten times as quick as `any()`.

    By their bytes: -0.0, which nothing here counts from, is taken for something else than 0.
    """
    return bool(values.tobytes().strip(b"\0"))


def all_set(flags: NDArray[np.bool_]) -> bool:
    """Whether all are true, as quickly."""
    return 0 not in flags.tobytes()
